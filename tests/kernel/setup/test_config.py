from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Literal

import counted_task
import pytest
from counted_task import LINE_TASK, install, line_plugins
from omegaconf import OmegaConf
from worlds import SMALL, make_training

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.options import as_typed, coerce
from understudy.setup.building import device_of
from understudy.setup.composition import compose_raw, load_experiment, readable, replaced
from understudy.setup.option_files import compose
from understudy.setup.plugins import Plugins, installed, load
from understudy.setup.root import Root
from understudy.setup.validation import refuse_code, validate
from understudy.testing import fake
from understudy.testing.fake import FAKE_TASK
from understudy_inspect.origins import origins
from understudy_sweeps.trial import written


def test_experiment(plugins: Plugins) -> None:
    experiment = load_experiment([*FAKE_TASK, *SMALL, "+reward.terms.near.weight=2"], plugins)
    assert experiment.root.num_worlds == 16
    assert experiment.need("scene").component.plugin == "fake"
    (near,) = experiment.many("reward.terms")
    assert (near.name, near.extras["weight"]) == ("near", 2.0)
    assert near.options == {"scale": 1.0}, "with its default"
    assert [t.extras["outcome"] for t in experiment.many("termination.terms")] == ["failure"]
    assert experiment.need("learner").options.rollout_steps == 8
    assert experiment.one("curriculum") is None
    used = {c.name for c in experiment.components()}
    assert {"fake", "fake/point", "fake/near_origin", "fake/far_away", "ppo", "mlp"} <= used


def test_null_removes_a_term(plugins: Plugins) -> None:
    more = ["+reward.terms.more={name: fake/near_origin, scale: 3}", "reward.terms.near=null"]
    experiment = load_experiment([*FAKE_TASK, *more], plugins)
    assert [t.name for t in experiment.many("reward.terms")] == ["more"]


def test_provenance(plugins: Plugins) -> None:
    """Each value with the file that set it, or the command line."""
    overrides = [
        "learner=ppo",
        "seed=3",
        "control.frequency=60",
        "+learner.clip=0.3",
        "evaluation.failures=[far]",
        "+scene={name: fake}",
        "+policy.noise={start: 1, end: 2}",
    ]
    origin = origins(overrides, plugins)
    assert "num_worlds" not in origin, "nobody set it"
    assert origin["learner.name"] == "learner/ppo.yaml [ppo]"
    assert origin["seed"] == "command line: seed=3"
    assert origin["control.frequency"] == "command line: control.frequency=60"
    assert origin["learner.clip"] == "command line: +learner.clip=0.3"
    assert origin["evaluation.failures"] == "command line: evaluation.failures=[far]"
    assert origin["scene.name"] == "command line: +scene={name: fake}"
    assert origin["policy.noise.end"] == "command line: +policy.noise={start: 1, end: 2}"


def test_every_value_has_an_origin(plugins: Plugins) -> None:
    def leaves(value: object, prefix: str = "") -> list[str]:
        if isinstance(value, dict) and value:
            return [
                x for k, v in value.items() for x in leaves(v, f"{prefix}.{k}" if prefix else k)
            ]
        return [prefix]

    overrides = ["experiment=spacetime/walk", "seed=3"]
    origin = origins(overrides, plugins)
    assert not [key for key in leaves(compose_raw(overrides, plugins)) if key not in origin]


def test_refuse_code() -> None:
    refuse_code({"a": [{"name": "x", "target": 1}]})
    with pytest.raises(
        ConfigError, match=r"^a\[0\]\.b\._target_: configurations name registered components"
    ):
        refuse_code({"a": [{"b": {"_target_": "os.system"}}]})


def test_composing_leaves_hydra_clean(plugins: Plugins) -> None:
    first = compose_raw([*FAKE_TASK], plugins)
    with pytest.raises(ConfigError):
        compose_raw(["learner=nothing"], plugins)
    assert compose_raw([*FAKE_TASK], plugins) == first


def test_values_that_no_file_mentions(plugins: Plugins) -> None:
    """The kernel's own file only lists groups; every value can be set without a plus."""
    assert set(compose_raw([], plugins)) <= {"task"}
    experiment = load_experiment(
        ["seed=3", "device=cpu", "difficulty=0.5", "budget.minutes=2"], plugins
    )
    root = experiment.root
    assert (root.seed, root.difficulty, root.budget.minutes) == (3, 0.5, 2.0)
    assert root.evaluation == Root().evaluation


def leaves(value: Any, prefix: str = "") -> dict[str, Any]:
    if isinstance(value, dict) and value:
        return {
            x: v
            for k, item in value.items()
            for x, v in leaves(item, f"{prefix}.{k}" if prefix else k).items()
        }
    return {prefix: value}


TASKS = {
    "fake": [*FAKE_TASK, *SMALL, "start={run: runs/a}", "+measure.x={name: line/value, reads: {x: qpos}}"],
    "walk": ["experiment=spacetime/walk", "evaluation.success={measure: within_all_bounds, at_least: 1}"],
    "nothing": [],
    "emptied": [*FAKE_TASK, *SMALL, "termination=null", "policy=null", "reward=null"],
}  # fmt: skip


@pytest.mark.parametrize("task", TASKS)
def test_the_effective_configuration_is_the_same_configuration(task: str) -> None:
    plugins = load(extra=[("fake", fake), ("line", counted_task)])
    experiment = load_experiment(TASKS[task], plugins)
    effective = json.loads(json.dumps(experiment.effective()))
    again = validate(effective, plugins.registry)
    assert again.choices == experiment.choices
    assert again.sections == experiment.sections
    assert again.effective() == effective


def test_the_effective_configuration_has_every_default(plugins: Plugins) -> None:
    found = leaves(load_experiment([*FAKE_TASK, *SMALL], plugins).effective())
    assert found["reward.terms.near.scale"] == 1.0
    assert found["reward.terms.near.weight"] == 1.0
    assert found["termination.terms.far.outcome"] == "failure"
    assert found["learner.gamma"] == 0.95
    assert found["policy.noise.samples"] == 1_000_000
    assert found["evaluation.gate"] == 0.3
    assert found["curriculum"] is None


def test_what_a_run_keeps_is_effective(tmp_path: Path) -> None:
    training = make_training(line_plugins(), LINE_TASK, tmp_path / "run")
    info = json.loads((tmp_path / "run/run.json").read_text())
    assert info["config"] == training.experiment.effective()
    assert info["config"]["learner"] == {"name": "line/nudge", "rollout_steps": 2, "rate": 1.0}
    assert info["layout"] == 3


def test_the_command_shows_defaults(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    install(monkeypatch, line_plugins())
    assert main(["config", *LINE_TASK, "learner.rate=3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    shown = {line.partition(": ")[0]: line.partition(": ")[2] for line in lines}
    assert shown["learner.rollout_steps"].split("  # ")[0].strip() == "2"
    assert shown["learner.rollout_steps"].endswith("# default of learner line/nudge [line]")
    assert shown["learner.rate"].endswith("# command line: learner.rate=3")
    assert shown["evaluation.gate"].endswith("# default of understudy")
    assert shown["curriculum"].endswith("# default of understudy")
    assert shown["control.frequency"].endswith("# command line: control.frequency=1")
    assert main(["config", "--json", *LINE_TASK]) == 0
    assert json.loads(capsys.readouterr().out)["learner"]["rate"] == 1.0


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("seed=x", r"^seed='x' is not possible: it takes a whole number\.$"),
        ("termination.terms=null", r"^termination\.terms=null is not possible"),
        ("evaluation.success=[3]", r"^evaluation\.success=\[3\] is not possible"),
        ("evaluation.success={measure: at}", r"^evaluation\.success.*at_least and at_most are both unset: give one of them\.$"),
        ("evaluation.success={mesure: at, at_least: 1}", r"^evaluation\.success has no option 'mesure'\. Did you mean 'measure'\?$"),
        ("evaluation.objective=speed", r"^evaluation\.objective names 'speed', which is no measure of this task\."),
        ("evaluation.failures=[fat]", r"^evaluation\.failures names 'fat', .*Did you mean 'far'\?$"),
        ("difficulty=1.5", r"^difficulty=1\.5 is not possible: it must be at most 1\.$"),
        ("control.decision=0", r"^control\.decision=0 is not possible"),
        ("start={parts: [actor]}", r"^start\.run is not set"),
        ("start={run: a, parts: [actr]}", r"^start\.parts\[0\]='actr' is not possible\. Did you mean 'actor'\?$"),
        ("+measure.at={name: line/value, reduce: median}", r"^measure\.at\.reduce='median' is not possible"),
        ("+reward.terms.near.reads=qpos", r"^reward\.terms\.near\.reads='qpos' is not possible"),
        ("+reward.terms.near.reads={qpos: null}", r"^reward\.terms\.near\.reads\.qpos=null is not possible"),
        ("+initial_states.reads={a: b}", r"^initial_states has no option 'reads'"),
        ("+reward.terms.near.wieght=2", r"^reward\.terms\.near has no option 'wieght'\. Did you mean 'weight'\?$"),
        ("+termination.terms.far.outcom=success", r"^termination\.terms\.far has no option 'outcom'\. Did you mean 'outcome'\?$"),
        ("+reward.terms.naer.weight=2", r"^reward\.terms has no 'naer'\. Did you mean 'near'\? A new one is written"),
        ("seed=[1, null, true]", r"^seed=\[1, null, true\] is not possible"),
        ("difficulty={a: null}", r"^difficulty=\{a: null\} is not possible"),
        ("numworlds=3", r"^There is no configuration key 'numworlds'\. Did you mean 'num_worlds'\?$"),
    ],
)  # fmt: skip
def test_errors_are_our_own_sentences(override: str, message: str) -> None:
    plugins = load(extra=[("fake", fake), ("line", counted_task)])
    with pytest.raises(ConfigError, match=message):
        load_experiment([*FAKE_TASK, "+policy={name: line/steady}", override], plugins)


@pytest.mark.parametrize("slot", ["policy", "learner", "simulator", "initial_states", "actuation"])
def test_a_slot_set_to_null_is_not_set(slot: str) -> None:
    plugins = line_plugins()
    experiment = load_experiment([*LINE_TASK, f"{slot}=null"], plugins)
    assert experiment.one(slot) is None
    with pytest.raises(ConfigError, match=rf"^{slot} is not set\. Choose an experiment"):
        experiment.need(slot)


@pytest.mark.parametrize(
    "overrides",
    [
        ["learner=ppo", "learner=null"],
        ["+learner={name: ppo}", "learner=null"],
        ["experiment=spacetime/walk", "learner=null"],
    ],
)
def test_a_group_of_options_set_to_null(plugins: Plugins, overrides: list[str]) -> None:
    """Hydra itself has no null for these."""
    assert load_experiment(overrides, plugins).one("learner") is None
    assert load_experiment([*overrides, "learner=ppo"], plugins).one("learner") is not None
    origin = origins(overrides, plugins)
    assert origin["learner"] == "command line: learner=null"
    assert not [key for key in origin if key.startswith("learner.")]


def test_a_choice_that_no_file_offers() -> None:
    with pytest.raises(
        ConfigError,
        match=r"^There is no such choice of measure\. Give one: 'measure=\{NAME: \{name: COMPONENT, …\}\}'\.$",
    ):
        load_experiment([*LINE_TASK, "measure=speed"], line_plugins())


def test_groups_set_to_null_are_empty() -> None:
    experiment = load_experiment([*LINE_TASK, "+termination.terms.far={name: line/beyond}", "termination=null", "measure=null"], line_plugins())  # fmt: skip
    assert experiment.many("termination.terms") == experiment.many("measure") == ()


def test_a_word_chooses_a_part_as_its_file_has_it() -> None:
    """What task and experiment say of their own choice is not mixed in; other overrides are."""

    def composed(*overrides: str) -> dict[str, Any]:
        return compose_raw(list(overrides))

    raw = composed("experiment=miniature/chopsticks", "policy=mlp", "policy.hidden=[8]")
    assert raw["policy"] == {"name": "mlp", "hidden": [8]}
    assert raw["learner"]["minibatches"] == 4, "the experiment's, which nothing replaces"
    assert composed("experiment=miniature/go", "learner=trpo")["learner"] == {"name": "trpo"}
    raw = composed("experiment=miniature/jumping", "termination=spacetime")
    assert raw["termination"] == composed("termination=spacetime")["termination"]
    raw = composed("experiment=spacetime/walk", "simulator=mujoco_warp")
    assert (raw["simulator"], raw["device"]) == ({"name": "mujoco_warp"}, "cuda")


@pytest.mark.parametrize(
    ("choice", "found"),
    [
        ("initial_states=spacetime/uniform", "characters/reference_states"),
        ("initial_states={name: miniature/somewhere}", "miniature/somewhere"),
    ],
)
def test_what_is_replaced_need_not_be_set(choice: str, found: str) -> None:
    raw = compose_raw(["task=miniature/dressing", choice])
    assert raw["initial_states"] == {"name": found}
    with pytest.raises(ConfigError, match=r"^initial_states.file is not set\. Give it a value\.$"):
        compose_raw(["task=miniature/dressing"])


def test_the_origin_of_a_part_that_a_word_chose() -> None:
    overrides = ["experiment=miniature/chopsticks", "policy=mlp", "policy.hidden=[8]"]
    origin = {k: v for k, v in origins(overrides).items() if k.startswith("policy.")}
    assert origin == {
        "policy.name": "policy/mlp.yaml [networks]",
        "policy.hidden": "command line: policy.hidden=[8]",
    }


def test_a_plugin_that_a_run_does_not_use_may_be_absent() -> None:
    effective = load_experiment(["experiment=spacetime/walk"]).effective()
    others = [p.name for p in load().loaded if p.name != "miniature"]
    assert validate(effective, load(only=others).registry).effective() == effective


def test_one_override_may_be_given_alone(plugins: Plugins) -> None:
    """As one writes it in Python; its letters are no overrides."""
    assert load_experiment("experiment=miniature/go", plugins).root.task == "miniature/go"


def test_overrides_replaced() -> None:
    old = ["+policy={name: a}", "seed=1", "++learner.rate=2", "~measure.x"]
    assert replaced(old, ["policy={name: b}", "learner.rate=3"]) == [
        "seed=1", "~measure.x", "policy={name: b}", "learner.rate=3",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "text",
    ["/a/b", "a b", "it's", 'say "x"', "a,b", "{a: b}", "[1]", "1", "null", "true", "ä→b", "a\\b", "end\\", "\\'", "a=b", "", " x "],
)  # fmt: skip
def test_strings_written_as_overrides(text: str) -> None:
    raw = compose_raw([f"start={written({'run': text, 'parts': ['actor']})}"], line_plugins())
    assert raw["start"] == {"run": text, "parts": ["actor"]}


def test_other_data_written_as_overrides() -> None:
    value = {"run": "a", "more": [1, 2.5, None, True, {"x": []}]}
    assert compose_raw([f"start={written(value)}"], line_plugins())["start"] == value


NAMES = (
    "clip (1).bvh",
    "läufer.bvh",
    "epoch=9.bvh",
    "take#2.bvh",
    "it's.bvh",
    "a;b & c.bvh",
    "~x!.bvh",
)


@pytest.mark.parametrize(
    "name",
    [
        *NAMES,
        "100% [new] {1}.bvh",
        "[1] walk.bvh",
        "{a}.bvh",
        "'a'.bvh",
        '"a".bvh',
        "back\\\\slash(\\'.bvh",
    ],
)
def test_names_outside_the_grammar_are_taken_as_they_are(name: str) -> None:
    """Hydra's grammar has no such words; quoted, they mean what was typed, and are quoted once."""
    override = readable(f"motion.file={name}")
    assert compose_raw(["experiment=spacetime/walk", override])["motion"]["file"] == name
    assert readable(override) == override
    listed = compose_raw(
        ["experiment=spacetime/walk", f"evaluation.failures=[root, {NAMES[0]},läufer]"]
    )
    assert listed["evaluation"]["failures"] == ["root", NAMES[0], "läufer"]


def test_a_list_without_brackets_is_a_file_if_there_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    override = "motion.file=walk,run.bvh"
    with pytest.raises(ConfigError, match="has several values and a run takes one"):
        compose_raw(["experiment=spacetime/walk", override])
    Path("walk,run.bvh").touch()
    Path("3").touch()
    Path("'x.bvh").touch()
    quote = compose_raw(["experiment=spacetime/walk", "motion.file='x.bvh"])
    assert quote["motion"]["file"] == "'x.bvh"  # which stays a sentence where there is no such file
    raw = compose_raw(["experiment=spacetime/walk", override, "seed=3"])
    assert (raw["motion"]["file"], raw["seed"]) == ("walk,run.bvh", 3)


@pytest.mark.parametrize("value", ["[0.1", "[[0, 1], [2, (3]", "{name: x", "'x", '"x'])
def test_what_begins_like_a_structure_is_not_taken_for_a_name(value: str) -> None:
    with pytest.raises(ConfigError, match=r"cannot be read\. Check brackets and quotes"):
        compose_raw(["experiment=spacetime/walk", f"motion.file={value}"])


def test_text_like_a_reference_has_a_backslash() -> None:
    with pytest.raises(ConfigError) as refused:
        compose_raw(["experiment=spacetime/walk", "motion.file=${x}.bvh"])
    said = re.search(r"As text it has a backslash: (\S+)\.$", str(refused.value))
    assert said
    assert said[1] == r"\${x}"  # and what it says works
    raw = compose_raw(["experiment=spacetime/walk", f"motion.file={said[1]}.bvh"])
    assert raw["motion"]["file"] == "${x}.bvh"


#: Words in which YAML or Hydra find a number or a truth value.
NUMERALS = ["2024", "0012", "00", "1e3", "1E3", "1_000", "+5", "-5", ".5", "5.", "1.50", "1e400", "true",
            "True", "FALSE", "inf", "NaN", "-inf", "0x10", "9" * 30]  # fmt: skip
IN_FILES = ["on", "No", "12:30", "0b11", "-.inf", "2024-01-05", "1:30.5"]


@pytest.mark.parametrize("word", [*NUMERALS, *IN_FILES])
def test_an_option_that_takes_text_takes_what_was_typed(word: str) -> None:
    words = ["experiment=spacetime/walk", f"run.dir={word}", f"++motion.name={word}"]
    listed = f"policy.feedback.observation=[{word}, x]"
    experiment = load_experiment(
        [*words, listed, f"reward.terms.survival.reads={{failed: {word}}}"]
    )
    assert experiment.root.run.dir == experiment.sections["motion"].name == word
    assert experiment.need("policy").options.feedback.observation == (word, "x")
    assert experiment.many("reward.terms")[0].extras["reads"] == {"failed": word}
    raw = compose_raw([*words[:2], "seed=1e3", "budget.minutes=.5"])
    assert validate(raw, installed().registry).root.run.dir == word  # what a run keeps is no other
    assert (raw["seed"], raw["budget"]["minutes"]) == (1000, 0.5)


@pytest.mark.parametrize("word", [*NUMERALS, *IN_FILES])
def test_a_file_of_options_takes_what_is_typed(word: str, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(
        f"dir: {word}\nlist: [{word}, x]\n{word}: y\nagain: ${{dir}}\nwithin: a/${{dir}}.b\nrate: 1e-3\n"
        f"choice: {word}\nflag: on\n"
    )
    found = OmegaConf.to_container(compose([tmp_path], ["+x=3"]), resolve=True)
    kinds = {"dir": str, "list": list[str], "again": str, "within": str, "rate": float,
             "choice": Literal["a", word], "x": int, "flag": bool}  # fmt: skip
    within = {"true": "True"}.get(
        word, word
    )  # what OmegaConf makes of it within a text, and Python of a key
    assert coerce(found, dict[str, Any], "x")[within] == "y"
    assert {key: coerce(found[key], kind, key) for key, kind in kinds.items()} == {
        "dir": word, "list": [word, "x"], "again": word, "within": f"a/{within}.b", "rate": 0.001,
        "choice": word, "x": 3, "flag": True,
    }  # fmt: skip


def test_what_else_an_option_takes_it_takes_first() -> None:
    number = as_typed(1000.0, "1e3")
    assert coerce(number, str | float, "x") == coerce(number, float | str | None, "x") == 1000.0
    assert coerce(True, str | bool, "x") is True
    assert coerce(number, Any, "x") == 1000.0
    assert coerce({"a": [number]}, Any, "x") == {"a": [1000.0]}
    assert coerce(None, str | None, "x") is None
    with pytest.raises(ConfigError, match=r"^x=1000\.0 is not possible: it takes a list of text"):
        coerce(number, tuple[str, ...], "x")


def test_a_number_names_a_file_of_options() -> None:
    for word in ("2024", "1e3", "true"):
        with pytest.raises(ConfigError, match=rf"^There is no experiment={word}\."):
            compose_raw([f"experiment={word}"])


def test_a_named_component_has_nothing_of_the_one_before_it() -> None:
    raw = compose_raw(["experiment=spacetime/walk", "policy={name: x, feedback: {a: 1}}"])
    assert raw["policy"] == {"name": "x", "feedback": {"a": 1}}


def test_of_two_that_share_a_number_one_may_take_the_text() -> None:
    found = compose_raw(["experiment=spacetime/walk", "run.dir=${num_worlds}", "num_worlds=1e3"])
    assert (found["run"]["dir"], found["num_worlds"]) == ("1e3", 1000)


@pytest.mark.parametrize(
    "name", ["mps", "meta", "xpu", "xla", "cpu:1", "CPU", "gpu", "", "cuda:", "cuda:-1", "cuda:x"]
)
def test_what_torch_calls_a_device_and_is_none_here(name: str) -> None:
    """``mps``, as on a Mac, was a traceback, and ``meta`` would have been numbers without values."""
    with pytest.raises(ConfigError, match=rf"^device={name} is no device\. Use cpu, cuda"):
        device_of(name)


def test_a_gpu_of_a_number_that_there_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.device_count", lambda: 2)
    assert device_of("cuda:1").index == 1
    with pytest.raises(ConfigError, match="device=cuda:2, but torch sees 2 of those here"):
        device_of("cuda:2")
    assert device_of("cpu:0").type == "cpu"
