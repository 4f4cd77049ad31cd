"""Files of options are read once, unless they change; what is composed of them is what Hydra composes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import lazy_choices
import pytest
from hydra.core.default_element import ResultDefault
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from understudy.errors import ConfigError
from understudy.options import plain
from understudy.setup import option_files
from understudy.setup.composition import compose_raw
from understudy.setup.option_files import OptionFiles, compose, parsed
from understudy.setup.plugins import Plugins

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "benchmarks"))

from composing import hydras


@pytest.fixture(autouse=True)
def hydra_itself() -> Iterator[None]:
    """Here Hydra makes its tables of choices as it does for users."""
    with lazy_choices.not_used():
        yield


@pytest.fixture
def x(tmp_path: Path) -> Callable[[], object]:
    """What a new composition finds for ``x`` in ``a.yaml`` of the folders ``first`` and ``second``."""
    folders = [tmp_path / "first", tmp_path / "second"]
    for folder in folders:
        folder.mkdir()

    def x() -> object:
        files = OptionFiles(folders)
        choice = ResultDefault(config_path="a", package="")
        return files.content(choice)["x"] if files.load_config("a") else None

    return x


def test_what_changes_is_read_anew(x: Callable[[], object], tmp_path: Path) -> None:
    assert x() is None
    (tmp_path / "second" / "a.yaml").write_text("x: 1\n")
    assert x() == 1
    (tmp_path / "second" / "a.yaml").write_text("x: 22\n")
    assert x() == 22
    (tmp_path / "first" / "a.yaml").write_text("x: 3\n")
    assert x() == 3
    (tmp_path / "first" / "a.yaml").unlink()
    assert x() == 22


def test_what_is_kept_is_not_what_is_handed_out(x: Callable[[], object], tmp_path: Path) -> None:
    (tmp_path / "first" / "a.yaml").write_text("defaults: [b]\nx: 1\n")
    found = OptionFiles([tmp_path / "first"]).load_config("a")
    assert found is not None
    assert found.defaults_list
    found.defaults_list.clear()
    assert OptionFiles([tmp_path / "first"]).load_config("a") != found
    value = parsed("a=[1,{b: [2]}]").value()
    assert isinstance(value, list)
    value[1]["b"].append(3)  # type: ignore[index, union-attr]
    assert parsed("a=[1,{b: [2]}]").value() == [1, {"b": [2]}]


def test_one_composition_leaves_nothing_to_the_next(plugins: Plugins) -> None:
    plain = ["experiment=spacetime/walk"]
    before = compose_raw(plain, plugins)
    for more in ("learner.gamma=0.5", "policy=mlp", "episode.seconds=3", "+learner.clip=0.1"):
        assert compose_raw([*plain, more], plugins) != before
    assert compose_raw(plain, plugins) == before


def test_what_was_composed_is_composed_anew_of_files_that_changed(tmp_path: Path) -> None:
    """Also where a file appears, goes, or a group comes to be one."""
    folders = [tmp_path / "first", tmp_path / "second"]
    for folder in folders:
        (folder / "part").mkdir(parents=True)
    (tmp_path / "second" / "config.yaml").write_text("defaults: [part: a, _self_]\nown: 1\n")
    (tmp_path / "second" / "part" / "a.yaml").write_text("x: 1\n")
    (tmp_path / "second" / "part" / "b.yaml").write_text("x: 2\n")

    def x(*overrides: str) -> object:
        composed = compose(folders, overrides)
        composed.part.x += 100  # nothing of it is seen by the next
        return composed.part.x - 100

    assert [x(), x(), x("part.x=7"), x("part=b"), x("part=b", "part.x=8"), x()] == [
        1,
        1,
        7,
        2,
        8,
        1,
    ]
    (tmp_path / "second" / "part" / "a.yaml").write_text("x: 33\n")
    assert x() == 33
    (tmp_path / "first" / "part" / "a.yaml").write_text("x: 4\n")
    assert [x(), x("part=b")] == [4, 2]
    (tmp_path / "first" / "part" / "a.yaml").unlink()
    assert x() == 33
    assert compose(folders, ["+other=c"]).other == "c"
    (tmp_path / "first" / "other").mkdir()
    (tmp_path / "first" / "other" / "c.yaml").write_text("z: 1\n")
    assert compose(folders, ["+other=c"]).other == {"z": 1}


def test_groups_of_their_own_are_merged_apart(tmp_path: Path) -> None:
    (tmp_path / "part").mkdir()
    (tmp_path / "config.yaml").write_text("defaults: [part: a, _self_]\npart: {y: 2}\n")
    (tmp_path / "part" / "a.yaml").write_text("x: 1\n")
    for _ in range(2):
        assert compose([tmp_path], ["part=a"]).part == {"x": 1, "y": 2}
        assert compose([tmp_path], ["part=a"], own={"part"}).part == {"x": 1}


def test_files_are_merged_once_for_all_values(
    plugins: Plugins, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Overrides that choose no file take nothing but time for what they set."""
    folders = [folder for _, folder in plugins.folders()]
    walk = ["experiment=spacetime/walk", "policy=mlp"]
    before = OmegaConf.to_container(compose(folders, walk))

    def again(*_: object) -> None:
        raise AssertionError("files were chosen anew")

    monkeypatch.setattr(option_files, "choices", again)
    first, second = (compose(folders, [*walk, f"++seed={seed}"]) for seed in (5, 6))
    assert (first.seed, second.seed) == (5, 6)
    assert OmegaConf.to_container(compose(folders, walk)) == before
    with pytest.raises(AssertionError, match="anew"):
        compose(folders, ["experiment=spacetime/walk", "policy=spacetime/dynamic"])


@pytest.mark.parametrize(
    "overrides",
    [
        ["experiment=spacetime/walk", "learner=ppo", "++learner.gamma=0.5"],
        ["experiment=miniature/go", "+reward.terms.more={name: a, b: [1, 2]}", "~simulator"],
        ["experiment=dressing/sleeve", "num_worlds=7"],
    ],
)
def test_it_is_what_hydra_composes(overrides: list[str], plugins: Plugins) -> None:
    folders = [folder for _, folder in plugins.folders()]
    ours = OmegaConf.to_container(compose(folders, overrides))
    assert plain(ours) == OmegaConf.to_container(hydras(folders, overrides))


def test_a_choice_may_follow_another(tmp_path: Path) -> None:
    """``${…}`` in a list of defaults: what Hydra composes, and another composition is none the wiser."""
    for group in ("part", "other"):
        (tmp_path / group).mkdir()
        for name in ("a", "b"):
            (tmp_path / group / f"{name}.yaml").write_text(f"x: {group}-{name}\n")
    (tmp_path / "config.yaml").write_text("defaults: [part: a, other: '${part}', _self_]\n")
    for overrides, other in (([], "other-a"), (["part=b"], "other-b"), ([], "other-a")):
        found = compose([tmp_path], overrides)
        assert found.other.x == other
        plain = OmegaConf.to_container(found)
        assert plain == OmegaConf.to_container(hydras([tmp_path, tmp_path], overrides))


def test_a_default_may_be_named_by_another_groups_choice(tmp_path: Path) -> None:
    for group in ("one", "other"):
        (tmp_path / group).mkdir()
        for name, value in (("a", 1), ("b", 2)):
            (tmp_path / group / f"{name}.yaml").write_text(f"x: {value}\n")
    (tmp_path / "config.yaml").write_text("defaults: [one: a, other: '${one}', _self_]\n")
    assert compose([tmp_path], []).other.x == 1
    assert compose([tmp_path], ["one=b"]).other.x == 2


def composed(folder: Path, overrides: list[str]) -> object:
    """What is composed of the files in `folder`, or the error that says why nothing is."""
    option_files._merged.clear()
    try:
        return OmegaConf.to_container(compose([folder], overrides))
    except (ConfigError, HydraException, OmegaConfBaseException, ValueError) as error:
        return f"{type(error).__name__}: {error}"


@pytest.mark.parametrize("overrides", [[], ["part=b"], ["part=[a,b]"], ["~part"]], ids=str)
@pytest.mark.parametrize(
    ("defaults", "fails"),
    [
        ("[part: a, other: '${part}', _self_]", False),
        ("[part: a, other: '${part}', third: '${other}']", True),
        ("[part: a, part@more: '${part}', 'optional other': z]", False),
        ("[part: a, 'other/${part}', part/a]", False),
        ("[part: a, other: [a, b], _self_]", False),
        ("[part: null, {other: null}, {override part: b}]", False),
        ("[part: a, other: '${nothing}']", True),
        ("[part: a, other: '${defaults.0.part}']", True),
        ("[part: 3]", True),
        ("[part: {a: 1}]", True),
        ("[part: [1, {a: 2}]]", True),
        ("[5]", True),
        ("[[part]]", True),
        ("[part: '???']", True),
        ("[nosuch: '${part}', part: a]", True),
    ],
)
def test_what_other_tests_compose_is_that(
    defaults: str, fails: bool, overrides: list[str], tmp_path: Path
) -> None:
    """Errors included, where tables of choices wait until they are asked for."""
    for group in ("part", "other", "third"):
        (tmp_path / group).mkdir()
        for name in ("a", "b"):
            (tmp_path / group / f"{name}.yaml").write_text(f"x: {group}-{name}\n")
    (tmp_path / "config.yaml").write_text(f"defaults: {defaults}\n")
    expected = composed(tmp_path, overrides)
    assert overrides or isinstance(expected, str) == fails, expected
    lazy_choices.use()
    assert composed(tmp_path, overrides) == expected
