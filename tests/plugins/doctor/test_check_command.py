"""``understudy motion check``."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from damage import between, raised, turned, walking
from recorded_runs import croucher_plugins, make_run, record, track

from understudy.command import cli
from understudy.setup import plugins
from understudy_characters.recording import recorded_clips
from understudy_doctor.findings import Severity
from understudy_humanoid.character import build_spec
from understudy_motion.clip import Clip
from understudy_motion.reading import read_clip
from understudy_motion.writers.bvh import BvhWriter
from understudy_motion.writers.table import NpzWriter

Z = (0.0, 0.0, 1.0)


@pytest.fixture(autouse=True)
def _humanoid_is_a_character(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = plugins.load()
    if "humanoid" not in loaded.registry.names("character"):
        from understudy.setup.registry import Registrar

        Registrar(loaded.registry, "tests").component("character", "humanoid", build_spec)
    monkeypatch.setattr(plugins, "installed", lambda: loaded)
    monkeypatch.setattr("understudy_doctor.command.installed", lambda: loaded)


@pytest.fixture
def sunk(tmp_path: Path, walks: Clip) -> Path:
    """A file of three cycles, 5 cm too low, with a spike at frame 90."""
    path = tmp_path / "sunk.npz"
    NpzWriter().write(raised(turned(walks, "neck", Z, 0.6 * between(walks, 90, 90)), -0.05), path)
    return path


def test_a_clean_clip(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["motion", "check", "walk"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("walk: 1.05 s, 65 frames")
    assert "on the humanoid" in shown
    assert "contact: left_ankle 0.00–0.11, 0.51–1.05 s" in shown
    assert shown.endswith("No findings.\n")


def test_a_foot_that_never_touches_the_ground_is_said_to(
    tmp_path: Path, walks: Clip, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "on_one_leg.npz"
    always = between(walks, 0, len(walks.times) - 1)
    NpzWriter().write(turned(walks, "left_hip", (0.0, 1.0, 0.0), -1.5 * always), path)
    cli.main(["motion", "check", str(path), "--character", "humanoid"])
    lines = capsys.readouterr().out.splitlines()
    assert "contact: left_ankle never" in lines
    assert any(re.fullmatch(r"contact: right_ankle [\d.].* s", line) for line in lines)


def test_findings_are_lines(sunk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["motion", "check", str(sunk)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == (
        "major: ground_offset at 0.00–3.15 s (frames 0–192): the clip stands on a floor 5.0 cm below "
        "z = 0. --fix OUT raises it."
    )
    assert lines[2].startswith("major: spike neck at 1.48 s (frame 90): jumps by 0.59 rad")
    assert lines[-1] == "2 major and 0 minor findings."


def test_minor_findings_are_no_failure(tmp_path: Path, walk: Clip) -> None:
    path = tmp_path / "unlicensed.npz"
    NpzWriter().write(replace(walk, licence="unknown"), path)
    assert cli.main(["motion", "check", str(path)]) == 0


def test_json_holds_everything(sunk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["motion", "check", str(sunk), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {
        "clip", "source", "licence", "seconds", "frames", "frame_rate", "loop", "character",
        "verdict", "findings", "ground", "contacts", "torque", "let_go", "skipped",
    }  # fmt: skip
    assert found["verdict"] == "major"
    assert found["character"] == "humanoid"
    assert found["ground"] == pytest.approx(-0.05, abs=1e-3)
    spike = found["findings"][1]
    assert set(spike) == {
        "kind", "severity", "what", "frames", "seconds", "joints", "value", "unit", "remedy",
    }  # fmt: skip
    assert (spike["kind"], spike["frames"], spike["joints"]) == ("spike", [90, 90], ["neck"])
    assert set(found["contacts"]) == {"right_ankle", "left_ankle"}
    assert found["torque"]["left_knee"]["peak"] > 10.0
    assert 0.05 < found["torque"]["left_knee"]["share"] < 1.0


def test_a_repaired_copy(sunk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "mended.npz"
    before = sunk.read_bytes()
    assert cli.main(["motion", "check", str(sunk), "--fix", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "repaired: interpolated neck over frames 90–90" in shown
    assert "repaired: moved the clip up or down by +5.0 cm" in shown
    assert "ground_offset: 1, at worst 0.05 m → none" in shown
    assert shown.endswith(f"{out}: No findings.\n")
    assert sunk.read_bytes() == before
    assert cli.main(["motion", "check", str(out)]) == 0
    mended = read_clip(out, plugins.installed().registry)
    assert mended.licence == "Apache-2.0 (generated)"
    again = ["motion", "check", str(sunk), "--fix", str(out), "--json"]
    kept = out.read_bytes()
    capsys.readouterr()
    assert cli.main(again) == 2
    assert f"{out} is there already." in capsys.readouterr().err
    assert out.read_bytes() == kept
    assert cli.main([*again, "--overwrite"]) == 0
    repaired = json.loads(capsys.readouterr().out)["repair"]
    assert repaired["file"] == str(out)
    assert len(repaired["done"]) == 2
    assert [finding["kind"] for finding in repaired["before"]] == ["ground_offset", "spike"]


def test_a_loop_is_cut_out(tmp_path: Path, walk: Clip, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "long.npz", tmp_path / "loop.npz"
    NpzWriter().write(walking(walk, 4), path)
    assert cli.main(["motion", "check", str(path), "--fix", str(out), "--loop"]) == 0
    assert "repaired: cut one cycle of 1.05 s" in capsys.readouterr().out
    loop = read_clip(out, plugins.installed().registry)
    assert loop.loop
    assert loop.duration == pytest.approx(walk.duration, abs=0.02)
    again = ["motion", "check", str(out), "--fix", str(tmp_path / "again.npz"), "--loop"]
    assert cli.main(again) == 2
    assert "loops already" in capsys.readouterr().err


def test_another_skeleton(tmp_path: Path, walk: Clip, capsys: pytest.CaptureFixture[str]) -> None:
    names = tuple(name.replace("knee", "shin") for name in walk.joint_names)
    assert walk.skeleton is not None
    other = replace(walk, joint_names=names, skeleton=replace(walk.skeleton, joint_names=names))
    path = tmp_path / "other.bvh"
    BvhWriter().write(other, path)
    assert cli.main(["motion", "check", str(path), "--unit", "m"]) == 1  # it is in centimetres
    assert "major: speed root" in capsys.readouterr().out
    arguments = ["motion", "check", str(path), "--unit", "cm"]
    assert cli.main(arguments) == 0
    assert "not checked: ground, feet, joint limits, torques: the clip's joints are" in (
        capsys.readouterr().out
    )
    assert cli.main([*arguments, "--character", "humanoid"]) == 1
    shown = capsys.readouterr().out
    assert "major: mapping right_knee, left_knee at" in shown
    assert "humanoid OUT.npz` makes it fit" in shown


def test_extra_joints_are_told_and_kept(
    tmp_path: Path, walk: Clip, capsys: pytest.CaptureFixture[str]
) -> None:
    import torch

    clip = raised(walk, -0.05)
    extra = torch.cat((clip.rotations, clip.rotations[:, -1:]), dim=1)
    clip = replace(clip, rotations=extra, joint_names=(*clip.joint_names, "tail"), skeleton=None)
    path, out = tmp_path / "tailed.npz", tmp_path / "out.npz"
    NpzWriter().write(clip, path)
    assert cli.main(["motion", "check", str(path), "--fix", str(out)]) == 0
    assert "minor: mapping tail at" in capsys.readouterr().out
    assert read_clip(out, plugins.installed().registry).joint_names == clip.joint_names


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no_such_clip"], "No motion clip 'no_such_clip'"),
        (["no/such.npz"], "there is no such file"),
        (["walk", "--character", "nobody"], "There is no character 'nobody'"),
        (["walk", "--loop"], "--loop makes a new clip"),
        (["walk", "--fix", "out.nothing"], "no format is written to '.nothing' files"),
        (["walk", "--page", "no/such/folder.html"], "could not be written"),
    ],
)
def test_what_the_user_can_cause_is_one_line(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["motion", "check", *arguments]) == 2
    shown = capsys.readouterr().err
    assert message in shown
    assert shown.count("\n") == 1


def test_the_clip_itself_is_not_replaced(sunk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sunk.read_bytes()
    assert cli.main(["motion", "check", str(sunk), "--fix", str(sunk)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert cli.main(["motion", "check", str(sunk), "--fix", str(sunk), "--overwrite"]) == 2
    assert "would replace the clip itself" in capsys.readouterr().err
    assert sunk.read_bytes() == before


# ---------------------------------------------------------------------- the page


class Elements(HTMLParser):
    """All start tags of a page, with their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, Any]]) -> None:
        self.found.append((tag, dict(attrs)))

    def values(self, attribute: str) -> list[str]:
        return [value for _, a in self.found if (value := a.get(attribute)) is not None]


def test_the_page_links_findings_and_places(sunk: Path, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    assert cli.main(["motion", "check", str(sunk), "--page", str(out)]) == 1
    elements = Elements(out.read_text(encoding="utf-8"))
    names, links = elements.values("id"), elements.values("href")
    assert len(names) == len(set(names))
    assert {link.removeprefix("#") for link in links} <= set(names)
    for number in range(2):
        assert f"finding-{number}" in names
        assert f"place-{number}" in names
    assert {"#finding-0", "#finding-1", "#place-0", "#place-1"} <= set(links)


def test_the_page_needs_nothing_else(sunk: Path, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    cli.main(["motion", "check", str(sunk), "--page", str(out)])
    text = out.read_text(encoding="utf-8")
    elements = Elements(text)
    assert {tag for tag, _ in elements.found}.isdisjoint({"script", "link", "img", "iframe"})
    assert elements.values("src") == []
    assert all(link.startswith("#") for link in elements.values("href"))
    assert "url(" not in text
    assert "default-src 'none'" in text
    assert out.stat().st_size < 500_000


def test_names_cannot_enter_the_page_as_code(tmp_path: Path, walk: Clip) -> None:
    evil = "<script>alert(1)</script>"
    clip = replace(
        raised(walk, -0.05), name=evil, licence=f"{evil} $policy", joint_names=(evil, *walk.joint_names[1:]),
        skeleton=None,
    )  # fmt: skip
    path, out = tmp_path / "evil.npz", tmp_path / "page.html"
    NpzWriter().write(clip, path)
    assert cli.main(["motion", "check", str(path), "--page", str(out)]) == 1
    assert evil not in out.read_text(encoding="utf-8")


def test_the_page_of_a_clip_without_a_character(tmp_path: Path, walk: Clip) -> None:
    names = tuple(f"other_{name}" for name in walk.joint_names)
    path, out = tmp_path / "other.npz", tmp_path / "page.html"
    NpzWriter().write(replace(walk, joint_names=names, skeleton=None), path)
    assert cli.main(["motion", "check", str(path), "--page", str(out)]) == 0
    text = out.read_text(encoding="utf-8")
    assert "Joint speeds" in text
    assert not re.search(r"<h2>(Contacts|Torque demand|Poses)</h2>", text)
    assert str(Severity.MAJOR) in text


def test_what_remains_is_not_to_be_fixed_again(
    sunk: Path, tmp_path: Path, walk: Clip, capsys: pytest.CaptureFixture[str]
) -> None:
    """Sliding that no repair takes away is not told to be repaired by the same command."""
    slow = replace(walking(walk), times=0.2 * walking(walk).times)
    path, out = tmp_path / "hasty.npz", tmp_path / "mended.npz"
    NpzWriter().write(slow, path)
    cli.main(["motion", "check", str(path), "--fix", str(out)])
    remains = [line for line in capsys.readouterr().out.splitlines() if line.startswith("remains")]
    assert remains
    assert not any("--fix" in line for line in remains)


def test_a_repaired_clip_has_its_own_title(sunk: Path, tmp_path: Path) -> None:
    out = tmp_path / "mended.npz"
    cli.main(["motion", "check", str(sunk), "--fix", str(out)])
    assert read_clip(out, plugins.installed().registry).name == "mended"


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a run that is not recorded yet."""
    loaded = croucher_plugins()
    monkeypatch.setattr(plugins, "installed", lambda: loaded)
    monkeypatch.setattr("understudy_doctor.command.installed", lambda: loaded)
    return make_run(tmp_path)


def test_what_a_run_learned_is_checked_by_its_own_character(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded = track(40)
    recorded[20, 0] += 0.5  # of the trunk, and back again
    record(run, qpos=recorded, first_episode=30)
    assert cli.main(["motion", "check", str(run), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert (found["character"], found["frames"], found["frame_rate"]) == ("croucher", 30, 30.0)
    spikes = [one["frames"] for one in found["findings"] if one["kind"] == "spike"]
    assert [20, 20] in spikes
    assert "CC BY 4.0" in found["licence"]
    mended = tmp_path / "mended.npz"
    cli.main(["motion", "check", str(run), "--fix", str(mended)])
    assert mended.exists()


def test_a_clip_is_checked_on_the_character_of_a_run(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of which a clip that was written from the run says nothing."""
    record(run, qpos=track(40), first_episode=40)
    clip = tmp_path / "written.npz"
    NpzWriter().write(recorded_clips(run)[0], clip)
    cli.main(["motion", "check", str(clip), "--json"])
    assert json.loads(capsys.readouterr().out)["character"] is None
    cli.main(["motion", "check", str(clip), "--character", str(run), "--json"])
    assert json.loads(capsys.readouterr().out)["character"] == "croucher"


def test_a_folder_that_is_no_run_has_no_character(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], walk: Clip
) -> None:
    NpzWriter().write(walk, tmp_path / "walk.npz")
    words = ["motion", "check", str(tmp_path / "walk.npz"), "--character", str(tmp_path)]
    assert cli.main(words) == 2
    assert "is no run folder" in capsys.readouterr().err


def test_a_skill_is_checked_by_its_name(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Which becomes a run folder as for every command that reads one."""
    record(run, qpos=track(40), first_episode=40)
    monkeypatch.setattr("understudy_doctor.command.run_folder", lambda name, **_: str(run))
    assert cli.main(["motion", "check", "spacetime/walk"]) in (0, 1)
    assert "40 frames at 30 frames/s, does not loop; on the croucher" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ([], "has no recording (recording.npz); make one with `understudy render "),
        (["--unit", "cm"], "--unit is of clip files; "),
        (["--source-rate", "60"], "--source-rate is of clip files; "),
        (["--character", "nosuch"], "There is no character 'nosuch'."),
    ],
)
def test_runs_that_cannot_be_checked(
    run: Path, more: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["motion", "check", str(run), *more]) == 2
    assert said in capsys.readouterr().err


def test_other_commands_say_how_a_run_becomes_a_clip(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.npz"
    for source in (str(run), "spacetime/walk"):
        assert cli.main(["motion", "retarget", source, "humanoid", str(out)]) == 2
        assert f"`understudy export {source} FILE.npz` makes one" in capsys.readouterr().err
    assert cli.main(["motion", "check", str(tmp_path)]) == 2
    assert "is a folder, and neither a clip nor a run" in capsys.readouterr().err
    assert cli.main(["motion", "retarget", "", "humanoid", str(out)]) == 2
    assert "'' names no clip, as of an empty variable" in capsys.readouterr().err
    assert not out.exists()
