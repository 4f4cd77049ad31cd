"""What is said about a part."""

from __future__ import annotations

import importlib
import re
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

import pytest

from understudy.errors import ConfigError, PluginError
from understudy.options import REQUIRED
from understudy.setup.plugins import Plugins, installed, load
from understudy_inspect.describe import describe, names


def test_a_learner() -> None:
    text = describe("learner/ppo", installed())
    assert text.startswith("learner/ppo: PPO: clipped, KL penalty, or both\n")
    assert "plugin ppo (understudy " in text
    assert re.search(r"^  gamma=0\.95 +number; discount of a decision", text, re.M)
    assert re.search(
        r"^  rollout_steps=16 +whole number; T, steps per world and iteration$", text, re.M
    )
    assert re.search(
        r"^  clip=0\.2 +number or null; ε of the clipping; null leaves it to kl_penalty$",
        text,
        re.M,
    )
    assert re.search(r"^  kl_penalty\.target=0\.01 ", text, re.M), "options of an option"
    assert "thesis' (section 3.5)" in text, "where defaults are from"
    assert "learner=spacetime/walk" in text
    assert "arXiv:1707.06347" in text
    assert describe("ppo", installed()) == text
    assert describe("learner=ppo", installed()) == text


@pytest.mark.parametrize(
    ("name", "option"),
    [
        ("control", r"substeps=20 +whole number; physics steps per control period"),
        ("resolution", r"substeps=null +whole number or null; physics steps per control period"),
        ("start", r"run=… +text; folder of the other run"),
    ],
)
def test_a_group_and_a_section(name: str, option: str) -> None:
    """Options of the kernel's own, and of a plugin's, in the same form."""
    text = describe(name, installed())
    assert re.match(rf"{name}\n(  .*\n)*  {option}", text)
    assert name in names(installed())


def test_a_term() -> None:
    text = describe("termination/beyond", installed())
    assert re.search(
        r"^  limit=… +number; least value that counts as beyond, in the field's unit$", text, re.M
    ), "it has to be given"
    assert re.search(r'^  outcome="failure" +failure or ', text, re.M)
    assert "Reads: value." in text


@pytest.mark.parametrize(
    ("name", "begins"),
    [("termination/beyond", "def beyond("), ("learner/ppo", "class PPO(")],
)
def test_where_a_part_is_defined(name: str, begins: str) -> None:
    found = re.search(r"^in (.+), line (\d+)$", describe(name, installed()), re.M)
    assert found is not None
    assert begins in Path(found[1]).read_text(encoding="utf-8").splitlines()[int(found[2]) - 1]


def files_in(text: str) -> list[str]:
    """The files that a description names."""
    found = re.search(r"^tests: (.+)$", text, re.M)
    return found[1].split(", ") if found else []


def test_where_a_parts_tests_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).parents[3])
    found = files_in(describe("termination/spacetime/com_bound", installed()))
    assert found[0] == "tests/plugins/spacetime/test_bounds.py", "it names the bound most"
    assert files_in(describe("learner/ppo", installed()))
    assert len(files_in(describe("scene/character", installed()))) == 5, "four, and how many more"


#: A package of one's own, and its tests: file by file.
OWN = {
    "pyproject.toml": "",
    "src/own_terms/__init__.py": """REQUIRES = ()
PARTS = {"reward": {"own/low": ("terms:low", "low"), "own/l": ("terms:left", ""), "own/un": ("terms:un", "")}}
""",
    "src/own_terms/terms.py": """def low(value): return -value
def left(value): return value
def un(value): return value
""",
    "tests/test_imported.py": "from own_terms.terms import low\nassert low(1) == -1",
    "tests/test_chosen.py": "words = ['reward.terms.a={name: own/low}', 'b=own/low', 'reward/own/low']",
    "tests/test_module.py": "from own_terms import terms\nterms.left(1)",
    "tests/test_others.py": "# low, own/low\nlow = 'own/lower', 'low', 'my/own/low'\ndef test_low(): low",
    "tests/test_broken.py": "low = (",
    "tests/test_escapes.py": "pattern = 'name: own/lower\\d'",
    "tests/test_bytes.py": "'name: own/low'\0",
    "tests/helper.py": "from own_terms.terms import un\nun(1)",
}


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Plugins]:
    for name, text in OWN.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path / "src")
    yield load(extra=[("own", importlib.import_module("own_terms"))])
    for name in [n for n in sys.modules if n.partition(".")[0] == "own_terms"]:
        del sys.modules[name]


def test_tests_beside_a_package_of_ones_own(own: Plugins) -> None:
    """Those that name the part: neither one of another name, nor a comment, nor what is no test."""
    Path("tests/test_nowhere.py").symlink_to("nothing")
    low = files_in(describe("reward/own/low", own))
    assert low == ["tests/test_chosen.py", "tests/test_imported.py"]
    assert files_in(describe("reward/own/l", own)) == ["tests/test_module.py"]
    assert files_in(describe("reward/own/un", own)) == []


@pytest.mark.parametrize("how", ["in an environment", "without a project", "without tests"])
def test_a_package_that_is_installed_names_no_tests(
    how: str, own: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if how == "in an environment":  # whose folder may well lie in somebody's project
        paths = {**sysconfig.get_paths(), "purelib": str(tmp_path / "src")}
        monkeypatch.setattr(sysconfig, "get_paths", lambda: paths)
    elif how == "without a project":
        (tmp_path / "pyproject.toml").unlink()
    else:
        (tmp_path / "tests").rename(tmp_path / "other")
    text = describe("reward/own/low", own)
    assert "\nin src/own_terms/terms.py, line 1\n" in text
    assert files_in(text) == []


def test_a_file_of_options() -> None:
    text = describe("experiment/spacetime/walk", installed())
    assert "(plugin spacetime: experiment/spacetime/walk.yaml)" in text
    assert "samples: 4080000" in text
    assert "rollout_steps=16" in describe("learner/spacetime/walk", installed())


def test_a_group_of_the_kernels() -> None:
    assert re.search(
        r"^  episodes=64 +whole number; of one draw", describe("evaluation", installed()), re.M
    )


def test_all_that_can_be_described() -> None:
    """Each has every option of the part in its text, with the default that is used."""
    plugins = installed()
    for (kind, name), component in plugins.registry.components.items():
        if kind == "command":
            continue
        try:
            text = describe(f"{kind}/{name}", plugins)
        except PluginError:  # an extra that is not installed here
            continue
        for option in component.options.values():
            assert re.search(rf"^  {option.name}(=|\.)", text, re.M), (kind, name, option.name)
            if option.default is REQUIRED:
                assert f"  {option.name}=…" in text
    assert {"learner/ppo", "experiment/spacetime/walk", "evaluation"} <= set(names(plugins))


@pytest.mark.parametrize("name", ["memory", "memory/"])
def test_a_kind_alone_lists_its_parts(name: str) -> None:
    lines = describe(name, installed()).splitlines()
    assert lines[0] == f"memory: {installed().registry.kinds['memory'].summary}"
    listed = {line.split()[0]: line.split(maxsplit=1)[1] for line in lines[1:]}
    assert listed["memory/running_mean"] == "a field's mean over the episode"
    assert len(listed) == sum(k == "memory" for k, _ in installed().registry.components)


def test_a_kind_that_is_almost_one_is_suggested() -> None:
    with pytest.raises(ConfigError, match=r"^There is nothing called 'encoders'\..*'encoder'\?$"):
        describe("encoders", installed())


def test_a_kind_that_is_a_group_of_the_configuration_lists_both() -> None:
    options, parts = describe("termination", installed()).split("\n\n")
    assert options.startswith("termination\n  terms=")
    assert re.search(r"^  termination/spacetime/com_bound +\S", parts, re.M)


def test_a_plugin_alone_lists_its_parts() -> None:
    lines = describe("spacetime", installed()).splitlines()
    assert lines[0] == "plugin spacetime"
    found = [c for c in installed().registry.components.values() if c.plugin == "spacetime"]
    assert {" ".join(line.split()) for line in lines[1:]} == {
        f"{c.kind}/{c.name} {c.summary}" for c in found
    }


def test_several_of_one_name() -> None:
    with pytest.raises(
        ConfigError, match=r"^There are several 'bvh': clip_reader/bvh, clip_writer/bvh\.$"
    ):
        describe("bvh", installed())


@pytest.mark.parametrize(
    ("option", "owner"),
    [
        ("learner/ppo.gamma", "learner/ppo"),
        ("budget.samples", "budget"),
        ("learner.gamma", "learner"),
    ],
)
def test_an_option_is_shown_with_what_it_is_of(option: str, owner: str) -> None:
    with pytest.raises(ConfigError, match=f"`understudy describe {owner}`"):
        describe(option, installed())


def test_an_experiment_as_it_is_chosen() -> None:
    text = describe("experiment/spacetime/walk", installed())
    assert describe("experiment=spacetime/walk", installed()) == text
