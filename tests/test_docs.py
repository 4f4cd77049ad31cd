"""The documents cannot rot: their commands compose, their code is the tested code, links exist."""

from __future__ import annotations

import atexit
import importlib
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from understudy.command.cli import main
from understudy.setup.building import build_environment
from understudy.setup.composition import compose_raw, load_experiment
from understudy.setup.plugins import Plugins, installed, load
from understudy.testing import check_plugin
from understudy_sweeps.command import expanded

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "plugins").rglob("README.md")),
]
TUTORIAL = ROOT / "docs" / "plugin-tutorial.md"
EXTERNAL = ROOT / "tests" / "external" / "understudy-balance"


def commands(page: Path) -> list[list[str]]:
    """The overrides of every train and sweep command of `page`, as the command composes them."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    found = re.findall(r"(?:^[ \t]*|`)understudy (train|sweep) ([^`\n]+)", text, re.M)
    words = [(command, shlex.split(line.rstrip("& "), comments=True)) for command, line in found]
    return [expanded(given) if command == "sweep" else given for command, given in words]


COMMANDS = [
    overrides
    for page in PAGES
    if page != TUTORIAL
    for overrides in commands(page)
    if not any(
        o.startswith("motion.file") or re.search(r"SKILL|=S|PART|…|\$", o) for o in overrides
    )
]


#: Those of the plugin that `understudy new plugin tall` writes.
NEW = [overrides for overrides in COMMANDS if "tall/" in " ".join(overrides)]


@pytest.mark.parametrize("overrides", [o for o in COMMANDS if o not in NEW], ids=" ".join)
def test_commands_compose(overrides: list[str]) -> None:
    if (compose_raw(overrides).get("simulator") or {}).get("name") == "mujoco_warp":
        pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed")
    load_experiment(overrides, installed())


def test_commands_of_a_new_plugin_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert main(["new", "plugin", "tall", "--folder", str(tmp_path / "tall")]) == 0
    monkeypatch.syspath_prepend(tmp_path / "tall" / "src")
    package = tmp_path / "tall" / "src" / "understudy_tall"
    page = (ROOT / "docs" / "how-do-i.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"^```yaml\n(.*?)^```", page, re.M | re.S)
    (where,) = re.findall(r"`src/understudy_tall/(conf/\S+)`", page)
    (package / where).parent.mkdir(parents=True)
    (package / where).write_text(shown, encoding="utf-8")
    plugins = load(extra=[("tall", importlib.import_module("understudy_tall"))])
    assert len(NEW) == 2
    for overrides in NEW:
        experiment = load_experiment([*overrides, "num_worlds=2"], plugins)
        build_environment(experiment).environment.close()
    (typed,) = (overrides for overrides in NEW if "encoder" in " ".join(overrides))
    asked = load_experiment(typed, plugins).effective()
    filed = load_experiment(["experiment=tall/walk"], plugins).effective()
    assert [filed[k] for k in ("encoder", "policy")] == [asked[k] for k in ("encoder", "policy")]


def test_the_demo_is_the_one_that_the_page_names() -> None:
    recipe = re.search(r"^demo:.*\n\t\S+understudy (.+)$", (ROOT / "Makefile").read_text(), re.M)
    assert recipe is not None
    named = re.search(
        r"^understudy (.+) seed=3 +# the demo", (ROOT / "docs" / "using.md").read_text(), re.M
    )
    assert named is not None
    assert named[1] == recipe[1]


def tutorial_files() -> dict[str, str]:
    """The files that the tutorial shows, by path."""
    text = TUTORIAL.read_text(encoding="utf-8")
    return dict(re.findall(r"^`(\S+)`:\n\n```\w+\n(.*?)```", text, re.M | re.S))


@pytest.fixture
def balance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Plugins]:
    """The installed plugins and the tutorial's, from files written as the page shows them."""
    for name, text in tutorial_files().items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path / "src")
    yield load(extra=[("balance", importlib.import_module("understudy_balance"))])
    for name in [n for n in sys.modules if n.partition(".")[0] == "understudy_balance"]:
        del sys.modules[name]


def test_the_tutorial_shows_all_of_the_tested_distribution() -> None:
    tested = {
        file.relative_to(EXTERNAL).as_posix(): file.read_text(encoding="utf-8")
        for file in EXTERNAL.rglob("*")
        if file.suffix in (".py", ".toml", ".yaml")
    }
    assert tutorial_files() == tested


def test_what_the_tutorial_grows_works(balance: Plugins) -> None:
    (added, *overrides) = commands(TUTORIAL)
    assert load_experiment(added, balance).need("policy").options.feedback.observation == (
        "state",
        "extra",
    )
    assert len(overrides) == 4
    for items in overrides:
        experiment = load_experiment(items, balance)
        assert "balance/upright" in [
            term.component.name for term in experiment.many("reward.terms")
        ]
    check_plugin("balance", balance)


def test_the_tests_that_the_tutorial_shows_pass(
    balance: Plugins, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But for the first, which is :func:`test_what_the_tutorial_grows_works`'s."""
    (code,) = (text for text in snippets(TUTORIAL) if "check_plugin(" in text)
    shown: dict[str, Any] = {}
    exec(compile(code, str(TUTORIAL), "exec"), shown)
    monkeypatch.setitem(shown, "load_experiment", lambda words: load_experiment(words, balance))
    names = [n for n in shown if n.startswith("test_") and n != "test_my_plugin"]
    assert len(names) == 2
    for name in names:
        shown[name]()


def test_the_term_in_the_readme_is_the_tutorials() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    shown: dict[str, Any] = {}
    exec(re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)[0], shown)
    taught: dict[str, Any] = {}
    exec(tutorial_files()["src/understudy_balance/terms.py"], taught)
    rotation = torch.nn.functional.normalize(
        torch.tensor([[1.0, 0, 0, 0], [0.9, 0.1, 0.3, 0.2]]), dim=1
    )
    assert torch.equal(shown["upright"](rotation), taught["upright"](rotation))
    named = yaml.safe_load(re.findall(r"^```yaml\n(.*?)^```", text, re.M | re.S)[0])
    assert named == {"reward": {"terms": {"upright": {"name": "balance/upright", "scale": 1.0}}}}


def test_the_dark_figure_differs_in_its_colours_alone() -> None:
    light, dark = (
        re.sub(r"#[0-9a-f]{6}", "COLOUR", (ROOT / f"docs/media/{name}.svg").read_text("utf-8"))
        for name in ("design", "design-dark")
    )
    assert light == dark


def snippets(page: Path) -> list[str]:
    """The Python of `page`."""
    return re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)


def test_from_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The page's four snippets, in a folder with the run that the third one opens."""
    pytest.importorskip("gymnasium", reason="Gymnasium is not installed (extra gym)")
    monkeypatch.chdir(tmp_path)
    words = ["experiment=miniature/go", "budget.samples=64", "num_worlds=4", "run.dir=runs/go"]
    words += ["evaluation.final_episodes=4", "run.video_seconds=0.2"]
    assert main(["train", *words]) == 0
    found = snippets(ROOT / "docs" / "from-python.md")
    assert len(found) == 4
    capsys.readouterr()
    for text in found:
        exec(compile(text, "from-python.md", "exec"), {})
    said = capsys.readouterr().out
    assert "distance " in said


LEARNERS = ROOT / "docs" / "other-learners.md"
#: By library: the shortest training that its snippet can be cut to.
SHORTENED = {
    "stable_baselines3": {
        "num_envs=64": "num_envs=4", "n_steps=32, batch_size=256": "n_steps=4, batch_size=8", "20_480": "32",
    },
    "rsl_rl": {"num_envs=64": "num_envs=4", '_env": 32': '_env": 4', "learn(10)": "learn(2)"},
    "skrl": {"num_envs=64": "num_envs=4", "rollouts=32": "rollouts=4", "size=32": "size=4", ": 320": ": 8"},
}  # fmt: skip


@pytest.fixture
def run_snippet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[[str, dict[str, str]], tuple[float, float]]:
    """Runs the page's training with a library, changed, in an empty folder; returns what it prints: the
    mean steps of an episode before and after."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(atexit, "register", lambda function: function)  # skrl's would come too late

    def run(library: str, changes: dict[str, str]) -> tuple[float, float]:
        pytest.importorskip(library, reason="it is not installed (extra learners)")
        (code,) = (s for s in snippets(LEARNERS) if f"understudy_gym.{library} import" in s)
        for old, new in changes.items():
            assert old in code, old
            code = code.replace(old, new)
        with torch.random.fork_rng():
            exec(compile(code, str(LEARNERS), "exec"), {})
        said = re.findall(r"mean episode before (\S+), after (\S+) steps", capsys.readouterr().out)
        return float(said[0][0]), float(said[0][1])

    return run


@pytest.mark.parametrize("library", SHORTENED)
def test_other_learners_take_what_the_page_gives_them(
    library: str, run_snippet: Any, tmp_path: Path
) -> None:
    changes = {**SHORTENED[library], 'Worlds("spacetime/walk", 64)': 'Worlds("spacetime/walk", 4)'}
    assert min(run_snippet(library, changes)) >= 1
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("library", SHORTENED)
def test_other_learners_learn_the_walk(library: str, run_snippet: Any) -> None:
    """Within 20 480 samples, about a minute each on two idle cores."""
    before, after = run_snippet(library, {})
    assert after > 1.3 * before


def test_the_page_shows_what_gymnasium_does() -> None:
    pytest.importorskip("gymnasium", reason="Gymnasium is not installed (extra gym)")
    names: dict[str, Any] = {}
    exec(compile(snippets(LEARNERS)[0], str(LEARNERS), "exec"), names)
    assert names["envs"].reset()[0].shape == (64, 274)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_exist(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target
