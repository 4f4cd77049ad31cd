"""``understudy cite`` and ``understudy licence``: nothing is missed, and the unknown is no permission."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import torch

from understudy.command.cli import main
from understudy.records import checkpoint
from understudy_credits.bibtex import entry
from understudy_credits.terms import Purpose, judge
from understudy_credits.walk import Made, answer, in_a_line, items_of, open_made
from understudy_reinforcement.licences import named
from understudy_reinforcement.origins import terms_behind
from understudy_skills import bank

CASES = {
    ("Apache-2.0", "commercial"): True,
    ("MIT License; see LICENSE beside the clip", "commercial"): True,
    ("CC BY 4.0", "commercial"): True,
    ("free for research and commercial use, not for resale as data", "commercial"): True,
    ("GPL-3.0-or-later", "commercial"): True,
    ("CC BY-NC 4.0", "commercial"): False,
    ("CC BY-NC 4.0", "sharing"): True,
    ("CC-BY-NC-SA-4.0", "commercial"): False,
    ("CC BY-ND 4.0", "sharing"): False,
    ("for non-commercial scientific research only", "commercial"): False,
    ("SMPL body model licence", "commercial"): False,
    ("academic use only", "research"): True,
    ("Copyright (c) 2020 Somebody. All rights reserved.", "commercial"): False,
    ("unknown", "research"): None,
    ("", "commercial"): None,
    ("ask me", "commercial"): None,
    ("Apache-2.0 AND CC BY-NC 4.0 AND unknown", "commercial"): False,
    ("Apache-2.0 AND unknown", "commercial"): None,
    ("Apache-2.0 (clip walk) AND unknown (model robot.xml)", "commercial"): None,
}


@pytest.mark.parametrize(("licence", "purpose"), CASES)
def test_what_a_licence_says(licence: str, purpose: Purpose) -> None:
    assert judge(licence, purpose).allowed is CASES[licence, purpose]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("                 Apache License\n       Version 2.0, January 2004", "Apache-2.0"),
        (
            "Copyright (c) X\nAll rights reserved.\n\nRedistribution and use in source and\nbinary forms",
            "BSD",
        ),
        ("Attribution-NonCommercial 4.0 International\n\n=====", "CC BY-NC"),
        ("Mine, all mine.\nmore", "Mine, all mine."),
        ("", "unknown"),
    ],
)
def test_whole_texts_are_known(text: str, name: str) -> None:
    assert named(text) == name


def run(tmp_path: Path, licence: str = "", clip: str = "CC BY 4.0", **info: Any) -> Path:
    """A run with a clip, and a robot with a mesh, whose folder has a licence or none."""
    folder = tmp_path / "run"
    copies = {"1/robot.xml": "<mujoco/>", "1/meshes/a.stl": "mesh", "2/bank.npz": "bank"}
    copies |= {"1/LICENSE": licence} if licence else {}
    for name, text in copies.items():
        (folder / "inputs" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "inputs" / name).write_text(text)
    inputs = {
        "mjcf /home/ada/robot.xml": {n: "0" * 64 for n in copies if n.startswith("1/")},
        "bank bank.npz": {"2/bank.npz": "0" * 64},
    }
    motion = {
        "clip": "crouch",
        "licence": clip,
        "attribution": "Recorded by Ada.",
        "source": "/c.bvh",
    }
    known = {
        "layout": 3,
        "config": {"scene": {"character": "/home/ada/robot.xml"}},
        "overrides": [],
        "sources": {"motion": motion},
        "components": [{"distribution": "understudy", "version": "0.2.0"}],
        "citations": ["Ada, Bob 2020. On walking & sitting. Journal 1(2), 3-4."],
        "inputs": inputs,
    }
    (folder / "run.json").write_text(json.dumps(known | info))
    return folder


def test_everything_is_walked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = run(tmp_path, "Attribution-NonCommercial 4.0 International")
    before = sorted(tmp_path.rglob("*"))
    assert main(["licence", str(folder), "--for", "commercial"]) == 1
    said = capsys.readouterr().out
    assert re.findall(r"^(yes|no|\?) +(\S+ \S+)", said, re.MULTILINE) == [
        ("yes", "code understudy"),
        ("yes", "clip crouch"),
        ("no", "model robot.xml"),
        ("no", "meshes of"),
        ("?", "file bank"),
    ]
    assert (
        "In the way of commercial use: model robot.xml, meshes of robot.xml (1), file bank" in said
    )
    assert "name: Recorded by Ada." in said
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("damaged", [False, True])
def test_a_bank_has_the_terms_of_its_clip(
    damaged: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the clip of the run that it was harvested from."""
    clip = {"clip": "leap", "licence": "MIT License", "attribution": "Leapt by Bea."}
    inputs = {"bank runs/ends": {"1/bank.json": "0" * 64, "1/bank.safetensors": "0" * 64}}
    folder = run(tmp_path, inputs=inputs)
    bank.save(folder / "inputs" / "1" / "bank", {"qpos": torch.zeros(2, 3)}, {"clip": clip})
    if damaged:
        (folder / "inputs" / "1" / "bank.json").write_text("[]")
    main(["licence", str(folder), "--for", "commercial", "--json"])
    (item,) = [i for i in json.loads(capsys.readouterr().out)["items"] if i["what"] == "file ends"]
    known = {"licence": "MIT License", "attribution": "Leapt by Bea."}
    assert item == {
        "what": "file ends",
        "source": "bank runs/ends",
        **({"licence": "unknown"} if damaged else known),
    }


def test_whoever_ships_a_skill_answers_for_the_weights_that_it_began_with() -> None:
    unknown = {"what": "weights of base", "licence": "unknown"}
    recorded = [{"what": "code understudy", "licence": "MIT"}, unknown, {**unknown, "what": "weights of held"}]  # fmt: skip
    start = {"start": {"run": "runs/base", "sources": {"start": {"run": "first"}}}}
    info = {"licence": {"items": recorded}, "sources": start}
    assert [item.what for item in items_of(Made("a.json", info))] == [row["what"] for row in recorded]  # fmt: skip
    shipped = items_of(Made("a/skill", info, shipped="understudy"))
    assert [(item.what, item.licence) for item in shipped] == [
        ("code understudy", "MIT"), ("weights of held", "unknown"), ("weights of a/skill", "Apache-2.0"),
    ]  # fmt: skip


def test_weights_that_it_began_with_are_followed(tmp_path: Path) -> None:
    inner = {"motion": {"clip": "fight", "licence": "CC BY-NC 4.0"}}
    start = {"run": "runs/other", "parts": ["actor"], "samples": 1}
    folder = run(tmp_path, "MIT", sources={"start": {**start, "sources": inner}})
    made = Made(str(folder), json.loads((folder / "run.json").read_text()), folder)
    licences = {item.what: item.licence for item in items_of(made)}
    # recorded before what is behind it was: its banks are not known
    assert licences["weights of other"] == "CC BY-NC 4.0 AND unknown"
    assert licences["clip fight"] == "CC BY-NC 4.0"
    behind = [{"clip": "fight", "licence": "CC BY-NC 4.0"}, {"model": "ape.xml", "licence": "MIT"}]
    folder = run(tmp_path, "MIT", sources={"start": {**start, "sources": inner, "behind": behind}})
    licences = {item.what: item.licence for item in items_of(open_made(str(folder)))}
    assert licences["weights of other"] == "CC BY-NC 4.0 AND MIT"
    assert licences["model ape.xml"] == "MIT"
    folder = run(tmp_path, "MIT", sources={"start": {**start, "sources": {}, "behind": []}})
    whats = [item.what for item in items_of(open_made(str(folder)))]
    assert "weights of other" not in whats, "nobody's"
    old = Made("old", {"sources": {"start": start}})  # recorded before that was kept
    assert {item.what: item.licence for item in items_of(old)}["weights of other"] == "unknown"


def test_policies_that_act_inside_are_followed_wherever_they_are_named(tmp_path: Path) -> None:
    """As stages of a sequence name them; of a pack the terms that it says, though its run is gone."""
    inputs = {"controller leap.json": {"3/leap.json": "0" * 64, "3/leap.safetensors": "0" * 64}}
    folder = run(tmp_path, "MIT", inputs=inputs)
    clip = {"what": "clip leap", "licence": "CC BY-NC 4.0", "attribution": "Leapt by Bea."}
    card = {"licence": {"items": [{"what": "code understudy", "licence": "Apache-2.0"}, clip]}}
    (folder / "inputs" / "3").mkdir()
    checkpoint.save(folder / "inputs" / "3" / "leap", {}, card)
    found = {item.what: item for item in items_of(open_made(str(folder)))}
    assert found["weights of leap.json"].licence == "CC BY-NC 4.0"
    assert found["clip leap"].attribution == "Leapt by Bea."


def test_what_is_unknown_says_whom_to_ask(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = run(tmp_path, "MIT", config={"job": {"name": "harvest", "run": "runs/leap"}})
    assert main(["licence", str(folder)]) == 1
    lines = capsys.readouterr().out.splitlines()
    (at,) = [i for i, line in enumerate(lines) if line.startswith("?   weights of leap")]
    assert lines[at + 1].strip() == "ask: understudy licence runs/leap"


@pytest.mark.parametrize(
    ("bank", "folder"),
    [("runs/ends", "runs/ends"), ("runs/ends/bank.json", "runs/ends"), ("a/bank", "a")],
)
def test_of_a_bank_the_run_that_left_it_is_asked(
    bank: str, folder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    made = run(tmp_path, "MIT", inputs={f"bank {bank}": {"2/bank.npz": "0" * 64}})
    assert main(["licence", str(made)]) == 1
    lines = capsys.readouterr().out.splitlines()
    (at,) = [i for i, line in enumerate(lines) if line.startswith("?   file ")]
    assert lines[at + 1].strip() == f"ask: understudy licence {folder}"
    assert lines[-1].startswith('What is marked "?" is unknown: ask those it comes from.')


def test_what_is_known_to_be_forbidden_is_no_question(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["licence", str(run(tmp_path, "GPL", "CC BY-NC 4.0", inputs={}))]) == 1
    assert "unknown" in capsys.readouterr().out, "of the model"
    folder = run(tmp_path, "GPL", "CC BY-NC 4.0", inputs={}, config={})
    assert main(["licence", str(folder)]) == 1
    assert '"?"' not in capsys.readouterr().out


NC = {"clip": "fight", "licence": "CC BY-NC 4.0", "attribution": "Fought by Cid."}
MIT = {"clip": "leap", "licence": "MIT License", "attribution": "Leapt by Bea."}


def test_a_bank_of_a_bank_has_the_terms_of_both_clips(tmp_path: Path) -> None:
    """A run that learned from one clip began where another had led: its ends were on the terms of the first alone."""
    first = run(tmp_path, sources={"motion": NC}, inputs={})
    for number in "34":
        (first / "inputs" / number).mkdir()
    bank.save(
        first / "inputs" / "3" / "bank",
        {"qpos": torch.zeros(2, 3)},
        {"clips": terms_behind(read(first), first)},
    )
    asked = {"bank runs/ends": {"3/bank.json": "0" * 64, "3/bank.safetensors": "0" * 64}}
    second = run(tmp_path, sources={"motion": MIT}, inputs=asked)
    found = terms_behind(read(second), second)
    assert found == [MIT, NC]
    bank.save(
        tmp_path / "run" / "inputs" / "4" / "bank", {"qpos": torch.zeros(2, 3)}, {"clips": found}
    )
    third = run(tmp_path, sources={}, inputs={"bank runs/more": {"4/bank.json": "0" * 64}})
    (item,) = [item for item in items_of(open_made(str(third))) if item.what == "file more"]
    assert item.licence == "MIT License AND CC BY-NC 4.0"
    assert item.attribution == "Leapt by Bea. Fought by Cid."


def test_states_behind_which_is_nobodys_clip_are_in_nobodys_way(tmp_path: Path) -> None:
    alone = run(tmp_path, sources={}, inputs={})
    assert terms_behind(read(alone), alone) == []
    (alone / "inputs" / "3").mkdir()
    bank.save(alone / "inputs" / "3" / "bank", {"qpos": torch.zeros(2, 3)}, {"clips": []})
    asked = {"bank runs/ends": {"3/bank.json": "0" * 64}}
    items = items_of(open_made(str(run(tmp_path, sources={}, inputs=asked, config={}))))
    assert [item.what for item in items] == ["code understudy"]


@pytest.mark.parametrize(
    ("info", "found"),
    [
        ({"sources": {"start": {"run": "a", "sources": {"motion": NC}}}}, [NC, {"licence": "unknown"}]),
        ({"sources": {"start": {"run": "a", "sources": {}, "behind": [NC, MIT]}}}, [NC, MIT]),
        ({"sources": {"start": {"run": "a", "sources": {"motion": NC}, "behind": []}}}, []),
        ({"sources": {"policy": {"run": "a", "behind": [NC]}, "bank": {"run": "b", "behind": [MIT]}}}, [NC, MIT]),
        ({"sources": {"bank": {"run": "b"}}}, [{"licence": "unknown"}]),
        ({"sources": {"clips": [NC, MIT]}, "config": {"job": {"clips": ["fight", "leap"]}}}, [NC, MIT]),
        ({"sources": {"poses": {"licences": ["MIT"]}}, "config": {"job": {"clips": ["a", "b"]}}}, [{"clip": "a, b", "licence": "MIT"}]),
        ({"sources": {}, "config": {"job": {"clips": ["a"]}}}, [{"clip": "a", "licence": "unknown"}]),
        ({"inputs": {"features runs/f": {"3/run.json": "0"}}}, [NC]),
        ({"inputs": {"grip.file=/home/ada/own.json": {"8/own.json": "0"}}}, [{"file": "own.json", "licence": "unknown"}]),
        ({"inputs": {"mjcf robot.xml": {"5/robot.xml": "0", "5/LICENSE": "0"}}}, [{"model": "robot.xml", "licence": "CC BY-NC"}]),
        ({"inputs": {"clip styles/angry.bvh": {"6/angry.bvh": "0", "6/angry.provenance.json": "0"}}},
         [{"clip": "angry.bvh", "licence": "CC BY-NC 4.0", "url": "https://a.b"}]),
        ({"licence": {"items": [{"what": "code understudy", "licence": "MIT"}, {"what": "weights of base", "licence": "unknown"}]}},
         [{"weights": "base", "licence": "unknown"}]),
        ({"sources": {"start": {"run": "a"}}}, [{"licence": "unknown"}]),
        ({"sources": {"policy": {"run": "a"}, "motion": MIT}}, [MIT, {"licence": "unknown"}]),
        ({"inputs": {"bank it": {"9/bank.json": "0"}}}, [{"licence": "unknown"}]),
        ({"inputs": {"controller it": {"9/run.json": "0"}}}, [{"licence": "unknown"}]),
        ({"inputs": {"controller it": {"../../bank.json": "0"}}}, [{"licence": "unknown"}]),
        ({"inputs": {"controller it": {"3/run.json": "0"}}}, [NC]),
        ({"inputs": {"controller it": {"3/policy.json": "0"}}}, [MIT]),
        ({"licence": {"items": [{"what": "clip leap", "licence": "MIT License", "attribution": "Leapt by Bea."}]}}, [MIT]),
        ({"sources": 3, "inputs": []}, []),
    ],
)  # fmt: skip
def test_whose_clips_are_behind_a_run(
    info: dict[str, Any], found: list[dict[str, str]], tmp_path: Path
) -> None:
    inner = tmp_path / "inputs" / "3"
    inner.mkdir(parents=True)
    (inner / "run.json").write_text(json.dumps({"sources": {"motion": NC}}))
    checkpoint.save(inner / "policy", {}, {"sources": {"motion": MIT}})
    for name, text in {
        "5/LICENSE": "Attribution-NonCommercial 4.0 International",
        "6/angry.provenance.json": json.dumps({"licence": "CC BY-NC 4.0", "url": "https://a.b"}),
    }.items():
        (tmp_path / "inputs" / name).parent.mkdir()
        (tmp_path / "inputs" / name).write_text(text)
    assert terms_behind(info, tmp_path) == found


def test_a_second_clip_and_one_that_only_its_copy_tells_of_are_walked(tmp_path: Path) -> None:
    """That of a style was left out, and that of a run that judges another one."""
    inputs = {
        "clip styles/angry.bvh": {n: "0" * 64 for n in ("3/angry.bvh", "3/angry.provenance.json")},
        "motion.name=sprint": {n: "0" * 64 for n in ("4/sprint.txt", "4/LICENSE")},
    }
    folder = run(tmp_path, sources={}, inputs=inputs)
    for name, text in {
        "3/angry.provenance.json": json.dumps({"licence": "CC BY 4.0", "url": "https://a.b/angry"}),
        "4/LICENSE": "Permission is hereby granted, free of charge, to any person",
    }.items():
        (folder / "inputs" / name).parent.mkdir(exist_ok=True)
        (folder / "inputs" / name).write_text(text)
    found = {item.what: item for item in items_of(open_made(str(folder)))}
    assert found["clip angry.bvh"].licence == "CC BY 4.0"
    assert found["clip angry.bvh"].source == "https://a.b/angry"
    assert found["clip sprint"].licence == "MIT"


def test_weights_inside_that_are_nobody_elses_are_in_nobodys_way(tmp_path: Path) -> None:
    """Of a run that learned from nothing that is somebody's; one that does not say from what is unknown."""
    known = {"config": {}, "sources": {}, "inputs": {}}
    for info, whats in ((known, []), ({}, ["weights of go"])):
        folder = run(
            tmp_path, sources={}, config={}, inputs={"controller runs/go": {"3/run.json": "0"}}
        )
        (folder / "inputs" / "3").mkdir(exist_ok=True)
        (folder / "inputs" / "3" / "run.json").write_text(json.dumps(info))
        items = items_of(open_made(str(folder)))
        assert [item.what for item in items] == ["code understudy", *whats]


@pytest.mark.parametrize("command", ["licence", "cite"])
def test_folders_of_runs_and_banks_say_what_to_name(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = run(tmp_path)
    bank.save(tmp_path / "bank", {"qpos": torch.zeros(2, 3)}, {})
    for source, said in (
        (tmp_path, f"{tmp_path} is no run folder: it has no run.json. Name one, as {folder}."),
        (tmp_path / "bank.json", f"is a bank of states, and no packed skill: name the run folder that has it, as {tmp_path}."),
    ):  # fmt: skip
        assert main([command, str(source)]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1


def read(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "run.json").read_text())
    return found


def test_a_policy_that_an_override_gave_a_pack_brings_its_terms(tmp_path: Path) -> None:
    """Of which its run has no copy."""
    (tmp_path / "leap").mkdir()
    (tmp_path / "leap" / "run.json").write_text(
        json.dumps({"sources": {"motion": MIT}, "config": {}, "inputs": {}})
    )
    made = open_made(str(run(tmp_path, "MIT", sources={}, inputs={}, config={})))
    found = answer(made, more={"controller runs/leap": [tmp_path / "leap" / "run.json"]})["items"]
    assert [item["what"] for item in found] == ["code understudy", "weights of leap", "clip leap"]
    assert found[1]["licence"] == "MIT License"


def test_the_answer_travels(tmp_path: Path) -> None:
    folder = run(tmp_path)
    made = Made(str(folder), json.loads((folder / "run.json").read_text()), folder)
    told = answer(made)
    assert told["commercial"][0] == "model robot.xml: nothing says on what terms it may be used"
    packed = Made("packed", {"licence": json.loads(json.dumps(told))})
    assert items_of(packed) == items_of(made)
    licence, attribution = in_a_line(made)
    assert licence.startswith("CC BY 4.0 (clip crouch) AND unknown (model robot.xml) AND ")
    assert judge(licence, "commercial").allowed is None
    assert attribution.startswith("Recorded by Ada. Commercial use: model robot.xml: nothing says")


def test_copies_lie_in_the_folder(tmp_path: Path) -> None:
    """Names of a stranger's run.json that lead out of it are not read."""
    (tmp_path / "LICENSE").write_text("Apache License Version 2.0")
    folder = run(
        tmp_path, inputs={"mjcf r.xml": {"../../LICENSE": "0", str(tmp_path / "LICENSE"): "0"}}
    )
    made = Made(str(folder), json.loads((folder / "run.json").read_text()), folder)
    assert {item.what: item.licence for item in items_of(made)}["model r.xml"] == "unknown"


@pytest.mark.parametrize(
    "broken", [{"inputs": {"mjcf x": 3}}, {"sources": [3]}, {"config": {"start": 7}}]
)
def test_damaged_records_are_no_traceback(tmp_path: Path, broken: dict[str, Any]) -> None:
    folder = run(tmp_path, **broken)
    assert main(["licence", str(folder)]) in (1, 2)


def test_bibtex(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cite", str(run(tmp_path))]) == 0
    said = capsys.readouterr().out
    assert "@software{understudy," in said
    assert "@article{ada2020on,\n  author = {Ada and Bob}" in said
    assert r"title = {{On walking \& sitting}}" in said
    assert "journal = {Journal 1(2), 3-4}" in said
    assert "@misc{clipcrouch," in said
    assert r"Recorded by Ada. Licence: CC BY 4.0" in said


def test_nothing_of_a_stranger_leaves_its_braces() -> None:
    found = entry(r"Eve} 2020. A} title{ \input{x}. Venue.", set())
    plain = re.sub(r"\\[{}]", "", found)
    assert plain.count("{") == plain.count("}")
    assert r"\input" not in found
