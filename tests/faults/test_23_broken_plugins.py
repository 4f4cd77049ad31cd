"""Fault 23: a plugin that cannot be loaded is named with its reason, and the others work."""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import pytest
from motion_files import write_npz
from worlds import SMALL

from understudy.command.cli import main
from understudy.command.command import Command
from understudy.errors import ConfigError, FileError, PluginError
from understudy.records.observer import RunObserver
from understudy.setup import plugins as plugins_module
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins, hookimpl, load
from understudy.setup.registry import Registrar, Registry
from understudy.signals import StopRequest
from understudy.task import Actuation, Encoder, Fields, InitialStates, Memory, box
from understudy.testing import fake
from understudy.testing.fake import FAKE_TASK
from understudy_characters.character import load_character
from understudy_motion import library
from understudy_motion.reading import ClipReader, read_clip
from understudy_motion.writing import write_clip
from understudy_skills.skill import open_skill


def module(options: Path | None = None, **hooks: Any) -> ModuleType:
    """With a package's folder `options` of options, which is called conf."""
    made = ModuleType("stranger")
    if options:
        made.__file__, made.__package__ = str(options.parent / "__init__.py"), "stranger"
    for name, function in hooks.items():
        setattr(made, name, hookimpl(function))
    return made


def status(plugins: Plugins, name: str = "stranger") -> str:
    return {p.name: p.status for p in plugins.loaded}[name]


def assert_isolated(plugins: Plugins, reason: str) -> None:
    """Listed once with its reason; nothing of it is left; the others train."""
    assert [p.name for p in plugins.loaded].count("stranger") == 1
    assert reason in status(plugins)
    assert "\n" not in status(plugins)
    assert not [c for c in plugins.registry.components.values() if c.plugin == "stranger"]
    assert not [t for t in plugins.registry.tasks.values() if t.plugin == "stranger"]
    assert not [s for s in plugins.registry.sections.values() if s.plugin == "stranger"]
    assert not [c for c in plugins.registry.citations if c[0] == "stranger"]
    assert "stranger_kind" not in plugins.registry.kinds
    assert "stranger_slot" not in plugins.registry.slots
    assert "stranger" not in [name for name, _ in plugins.folders()]
    assert all(p.status == "ok" for p in plugins.loaded if p.name in ("ppo", "mujoco", "fake"))
    build_environment(load_experiment([*FAKE_TASK, *SMALL], plugins)).environment.reset()
    raw = [*FAKE_TASK, *SMALL, "learner.name=stranger/learner"]
    with pytest.raises(ConfigError) as caught:
        load_experiment(raw, plugins)
    assert f"Plugin 'stranger' did not load: {status(plugins)}" in str(caught.value)
    assert "Known:" not in str(
        caught.value
    )  # what is missing is its plugin, no part to be chosen instead


def loaded(stranger: Any) -> Plugins:
    return load(extra=[("fake", fake), ("stranger", stranger)])


def duplicate(register: Registrar) -> None:
    register.component("learner", "stranger/learner", object)
    register.component("learner", "ppo", object)


def duplicate_section(register: Registrar) -> None:
    register.section("stranger", dict, dict)
    register.task("stranger/task", "a task")
    register.component("learner", "stranger/learner", object)
    register.component("learner", "stranger/learner", object)


def unknown_kind(register: Registrar) -> None:
    register.component("learner", "stranger/learner", object)
    register.component("lerner", "stranger/other", object)


def kinds(register: Registrar) -> None:
    register.kind("stranger_kind", "of its own")
    register.slot("stranger_slot", "stranger_kind", "of its own")
    register.citation("stranger", "Stranger 2001.")
    register.component("stranger_kind", "x", object)
    register.slot("job", "job", "the kernel's")


def dotted(register: Registrar) -> None:
    register.slot("reward.more", "reward", "below another's")


def raises(register: Registrar) -> None:
    register.component("learner", "stranger/learner", object)
    raise RuntimeError("no\nlicence")


def leaves(register: Registrar) -> None:
    sys.exit("stranger wants to leave")


@pytest.mark.parametrize(
    ("register", "reason"),
    [
        (duplicate, "Both plugin 'ppo' and plugin 'stranger' register the learner 'ppo'"),
        (duplicate_section, "register the learner 'stranger/learner'"),
        (unknown_kind, "no kind of component. Did you mean 'learner'?"),
        (kinds, "Both understudy itself and plugin 'stranger' register the slot 'job'"),
        (dotted, "registers the slot 'reward.more', whose name has a dot"),
        (raises, "RuntimeError: no"),
        (leaves, "SystemExit: stranger wants to leave"),
    ],
)
def test_registering(register: Any, reason: str) -> None:
    assert_isolated(loaded(module(understudy_register=register)), reason)


PART = {"learner": {"stranger/learner": ("parts:Learner", "learns")}}


@pytest.mark.parametrize(
    ("tables", "reason"),
    [
        ({"KINDS": ["stranger_kind"]}, "table KINDS is not as tables are. Write KINDS = {"),
        ({"KINDS": {"stranger_kind": 5}}, "registers the kind 'stranger_kind'"),
        ({"SLOTS": {"stranger_slot": ("learner", "x")}}, "Write SLOTS = {"),
        ({"SLOTS": {"stranger_slot": {"sort": "learner"}}}, "Write SLOTS = {"),
        ({"SLOTS": {"job": {"kind": "job", "summary": "x"}}}, "understudy itself and plugin 'stranger' register the slot 'job'"),
        ({"PARTS": {"learner": "parts:Learner"}}, "Write PARTS = {"),
        ({"PARTS": {"learner": {"stranger/other": "parts:Other"}}}, "Write PARTS = {"),
        ({"PARTS": {"learner": {"ppo": ("parts:PPO", "learns")}}}, "register the learner 'ppo'"),
        ({"PARTS": {"learner": {"stranger/other": (5, "learns")}}}, "registers 5 as the learner"),
        ({"PARTS": {"lerner": {"x": ("parts:X", "learns")}}}, "Did you mean 'learner'?"),
        ({"SECTIONS": {"stranger": "section:Build"}}, "Write SECTIONS = {"),
        ({"SECTIONS": {"seed": ("s:Options", "s:build")}}, "understudy itself and plugin 'stranger' register the section"),
        ({"TASKS": "stranger/task"}, "Write TASKS = {"),
        ({"TASKS": {"stranger/task": None}}, "registers the task 'stranger/task'"),
        ({"CITATIONS": {"stranger": ("Stranger", "2001")}}, "registers the citation"),
        ({"CITATION": {"stranger": "Stranger 2001."}}, "Did you mean 'CITATIONS'?"),
        ({"PART": PART}, "its table 'PART' is none. Did you mean 'PARTS'?"),
    ],
)  # fmt: skip
def test_tables(tables: dict[str, Any], reason: str) -> None:
    stranger = ModuleType("stranger")
    vars(stranger).update({"PARTS": PART, **tables})
    assert_isolated(loaded(stranger), reason)


def test_a_hook_that_breaks_takes_the_tables_along() -> None:
    stranger = module(understudy_register=raises)
    vars(stranger).update(
        KINDS={"stranger_kind": "of its own"}, TASKS={"stranger/task": "learned"}, ITEMS={"a": 1}
    )
    assert_isolated(loaded(stranger), "RuntimeError: no")


def test_misspelled_hook() -> None:
    def register(register: Registrar) -> None:
        register.component("learner", "stranger/learner", object)

    assert_isolated(
        loaded(module(understudy_register=register, understudy_registre=register)),
        "understudy_registre",
    )
    plain = ModuleType("stranger")
    plain.understudy_regster = register  # type: ignore[attr-defined]  # not even marked as a hook
    assert_isolated(
        loaded(plain),
        "defines 'understudy_regster', which is no hook. The hook is understudy_register.",
    )


def test_wrong_hook_signature() -> None:
    assert_isolated(loaded(module(understudy_register=lambda register, more: None)), "stranger")


def test_config_directories(tmp_path: Path) -> None:
    (tmp_path / "conf/learner").mkdir(parents=True)
    (tmp_path / "conf/learner/ppo.yaml").write_text("name: stranger/learner\n")
    shadows = module(tmp_path / "conf")
    assert_isolated(
        loaded(shadows), "the config option 'learner/ppo', which plugin 'ppo' provides already"
    )
    (tmp_path / "mine/conf/experiment").mkdir(parents=True)
    (tmp_path / "mine/conf/config.yaml").write_text("seed: 7\n")
    takes = module(tmp_path / "mine/conf")
    assert_isolated(
        loaded(takes), "the config option 'config', which understudy itself provides already"
    )


class Distribution(NamedTuple):
    name: str
    version: str = "1.0"


class Entry(SimpleNamespace):
    """An entry point of a distribution ``strange`` 1.0."""

    def load(self) -> ModuleType:
        if isinstance(self.what, BaseException):
            raise self.what
        return self.what


def with_entry(monkeypatch: pytest.MonkeyPatch, *entries: Entry) -> None:
    real = metadata.entry_points

    def found(**of: Any) -> Any:
        there = real(**of)
        return [*there, *entries] if of == {"group": "understudy"} else there

    monkeypatch.setattr(metadata, "entry_points", found)


def entry(what: Any, value: str = "stranger", dist: str = "strange") -> Entry:
    return Entry(name="stranger", value=value, what=what, dist=Distribution(dist))


@pytest.mark.parametrize(
    "error",
    [
        ImportError("libgone.so is missing"),
        ZeroDivisionError("x"),
        SystemExit("bye"),
        SyntaxError("y"),
    ],
)
def test_import(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    with_entry(monkeypatch, entry(error))
    plugins = load(extra=[("fake", fake)])
    assert_isolated(plugins, f"{type(error).__name__}: {error}")
    found = next(p for p in plugins.loaded if p.name == "stranger")
    assert (found.distribution, found.version) == ("strange", "1.0")


def test_bundled_plugins_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stranger whose name sorts before cannot take a bundled plugin's place."""
    stranger = entry(module(understudy_register=duplicate))
    stranger.name = "aaa"
    with_entry(monkeypatch, stranger)
    plugins = load()
    assert status(plugins, "ppo") == "ok"
    assert "Both plugin 'ppo' and plugin 'aaa'" in status(plugins, "aaa")


def test_component_whose_module_is_missing() -> None:
    """Registered lazily: only asking for it fails, and says whose it is."""

    def register(register: Registrar) -> None:
        register.component("learner", "stranger/learner", "no_such_module:Learner")
        register.component("learner", "stranger/other", "understudy_ppo.learner:Missing")

    plugins = loaded(module(understudy_register=register))
    assert status(plugins) == "ok"
    for name, reason in (
        ("learner", "No module named 'no_such_module'"),
        ("other", "which does not exist"),
    ):
        with pytest.raises(
            Exception, match=rf"learner 'stranger/{name}' of plugin 'stranger' .*{reason}"
        ):
            load_experiment([*FAKE_TASK, *SMALL, f"learner.name=stranger/{name}"], plugins)


def test_commands(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    with_entry(monkeypatch, entry(ImportError("libgone.so is missing")))
    plugins_module.installed.cache_clear()
    try:
        assert main(["plugins"]) == 0
        assert (
            "stranger 1.0 (strange): ImportError: libgone.so is missing" in capsys.readouterr().out
        )
        assert main(["config", "learner=stranger/learner"]) == 2
        assert (
            "Plugin 'stranger' did not load: ImportError: libgone.so is missing"
            in capsys.readouterr().err
        )
    finally:
        plugins_module.installed.cache_clear()


def test_disabled(monkeypatch: pytest.MonkeyPatch) -> None:
    with_entry(monkeypatch, entry(ImportError("x")))
    monkeypatch.setenv("UNDERSTUDY_DISABLE_PLUGINS", "stranger, mujoco")
    assert not {"stranger", "mujoco"} & {p.name for p in load().loaded}
    monkeypatch.setenv("UNDERSTUDY_PLUGINS", "ppo,stranger")
    assert [p.name for p in load().loaded] == ["ppo"]


def test_a_name_that_is_no_plugin_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNDERSTUDY_PLUGINS", "ppo,nope")
    with pytest.raises(
        PluginError, match="UNDERSTUDY_PLUGINS names 'nope', which is no installed plugin"
    ):
        load()
    monkeypatch.setenv("UNDERSTUDY_PLUGINS", "moton")
    with pytest.raises(PluginError, match="Did you mean 'motion'"):
        load()


def unharmed(function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """What the function returns; the interrupt of a plugin would end all tests."""
    try:
        return function(*arguments, **named)
    except BaseException as error:
        raise AssertionError("it went through") from error


class Wordless(Exception):
    """One that cannot say what it is."""

    def __str__(self) -> str:
        raise RuntimeError("nothing to say")


class Own(BaseException):
    """One that is no Exception."""


ENDINGS = [Own("own"), KeyboardInterrupt("stranger"), GeneratorExit("x"), SystemExit(3), Wordless()]


def reason(error: BaseException) -> str:
    kind = type(error).__name__
    return "Wordless, which cannot say what it is" if kind == "Wordless" else f"{kind}: {error}"


@pytest.mark.parametrize("error", ENDINGS, ids=reason)
@pytest.mark.parametrize("when", ["import", "register", "look"])
def test_whatever_it_raises(
    monkeypatch: pytest.MonkeyPatch, error: BaseException, when: str
) -> None:
    """Under the command line's watch for stop signals, of which there is none here."""

    def fail(_: Any) -> None:
        raise error

    def register(register: Registrar) -> None:
        fail(register)

    what = {
        "import": error,
        "register": module(understudy_register=register),
        "look": type("Touchy", (ModuleType,), {"__file__": property(fail)})("stranger"),
    }[when]
    with_entry(monkeypatch, entry(what))
    with StopRequest(at_once=True):
        assert_isolated(unharmed(load, extra=[("fake", fake)]), reason(error))


def test_a_stop_signal_at_an_import_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    class Signalled(Entry):
        def load(self) -> ModuleType:
            os.kill(os.getpid(), signal.SIGTERM)
            return module()

    with_entry(monkeypatch, Signalled(**vars(entry(None))))
    with StopRequest(at_once=True) as stop:
        with pytest.raises(KeyboardInterrupt):
            load()
        assert stop.received == signal.SIGTERM
        stop.received = None  # it goes no further


@pytest.mark.parametrize(
    "name",
    ["train", "resume", "", " ", "motion", "motion check", "a b c", "plugins", "--help", "-x", "x\ny",
     "train more", "sweep more", "a  b", None, 5],
)  # fmt: skip
def test_commands_that_cannot_be(name: Any) -> None:
    def register(register: Registrar) -> None:
        register.component("command", name, object, "a command")
        register.component("learner", "stranger/learner", object)

    assert_isolated(loaded(module(understudy_register=register)), "the command")


@pytest.mark.parametrize("what", ["component", "target", "summary", "task", "section", "kind", "slot",
                                  "citation", "taken", "taken slot"])  # fmt: skip
def test_parts_without_a_name(what: str) -> None:
    def register(register: Registrar) -> None:
        odd: Any = None
        register.component("learner", "stranger/learner", object)
        {
            "component": lambda: register.component("learner", "", object),
            "target": lambda: register.component("learner", "stranger/other", odd),
            "summary": lambda: register.component("learner", "stranger/other", object, odd),
            "task": lambda: register.task("", "x"),
            "section": lambda: register.section("", dict, dict),
            "kind": lambda: register.kind("", "x"),
            "slot": lambda: register.slot("\n", "learner", "x"),
            "citation": lambda: register.citation("stranger", odd),
            "taken": lambda: register.section("seed", dict, dict),
            "taken slot": lambda: register.slot("budget", "learner", "x"),
        }[what]()

    both = "Both understudy itself and plugin 'stranger'"
    reason = both if what.startswith("taken") else "Plugin 'stranger'"
    assert_isolated(loaded(module(understudy_register=register)), reason)


@pytest.mark.parametrize("value", [5, None, lambda register: None], ids=["5", "None", "unmarked"])
def test_hooks_that_are_none(value: Any) -> None:
    stranger = ModuleType("stranger")
    stranger.understudy_register = value  # type: ignore[attr-defined]
    assert_isolated(
        loaded(stranger),
        "its 'understudy_register' is no function marked with @understudy.hookimpl",
    )


def bomb(levels: int = 9) -> bytes:
    rows = [b"a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    for k in range(1, levels):
        rows.append(b"a%d: &a%d [%s]" % (k, k, b", ".join([b"*a%d" % (k - 1)] * 9)))
    return b"\n".join(rows)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"name: \xff\xfe", "is not UTF-8"),
        (b"name: [", "is not YAML"),
        (b"name: *nobody", "is not YAML"),
        (bomb(), "has too many values"),
        (b"a: &a [*a]", "is nested too deep, or in itself"),
        (b"[" * 5000, "is nested too deep, or in itself"),
        (None, "cannot be read: Is a directory"),
        (b"x: " + b"1" * 2**21, "cannot be read: it is larger than 1 MiB"),
    ],
    ids=["utf-8", "yaml", "anchor", "bomb", "itself", "deep", "folder", "large"],
)
def test_options_that_cannot_be_read(tmp_path: Path, content: bytes | None, why: str) -> None:
    file = tmp_path / "conf/learner/strange.yaml"
    file.parent.mkdir(parents=True)
    if content is None:
        file.mkdir()
    else:
        file.write_bytes(content)
    stranger = module(tmp_path / "conf")
    assert_isolated(loaded(stranger), f"its config option 'learner/strange' {why}")


PACKAGE = "# @package _global_\ndefaults: [/experiment/miniature/go, _self_]\n"


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (f"{PACKAGE}seed: 3\nseed: 4\n", r"odd\.yaml cannot be read: .*duplicate key seed"),
        (f"{PACKAGE}budget: {{samples: 3}}\nbudget: {{minutes: 4}}\n", "duplicate key budget"),
        (f"{PACKAGE}seed: !!python/object/apply:os.getcwd []\n", "cannot be read: could not determine"),
        (f"{PACKAGE}seed: 010\n", "seed='010' is not possible"),
        (f"{PACKAGE}seed: -0_10\n", "seed='-0_10' is not possible"),
        (f"{PACKAGE}budget: {{minutes: 1:30}}\n", "budget.minutes='1:30' is not possible"),
        (f"{PACKAGE}budget: {{minutes: 1:30.5}}\n", "budget.minutes='1:30.5' is not possible"),
        ("defaults: [/experiment/miniature/go, _self_]\nseed: 3\n", "begins with '# @package _global_'"),
        ("", "begins with '# @package _global_'"),
        ("# @package _global_\ndefaults: [/experiment/odd, _self_]\n", "builds on itself"),
    ],
)  # fmt: skip
def test_a_file_of_options_says_what_is_wrong_with_it(
    tmp_path: Path, content: str, why: str
) -> None:
    """None is a traceback, and no number another one than a reader takes it for (YAML has 8 for 010, 90 for 1:30)."""
    (tmp_path / "conf/experiment").mkdir(parents=True)
    (tmp_path / "conf/experiment/odd.yaml").write_text(content)
    plugins = loaded(module(tmp_path / "conf"))
    assert status(plugins) == "ok"
    with pytest.raises(ConfigError, match=why) as caught:
        load_experiment(["experiment=odd"], plugins)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("said", "seed"), [("10", 10), ("1_000", 1000), ("1e3", 1000), ("0", 0), ("&a 7", 7), ("+3", 3)]
)
@pytest.mark.parametrize("written", ["utf-8", "utf-8-sig", "CRLF"])
def test_a_file_of_options_as_editors_write_it(
    tmp_path: Path, said: str, seed: int, written: str
) -> None:
    (tmp_path / "conf/experiment").mkdir(parents=True)
    text = f"{PACKAGE}seed: {said}\n"
    if written == "CRLF":
        text, written = text.replace("\n", "\r\n"), "utf-8"
    (tmp_path / "conf/experiment/odd.yaml").write_bytes(text.encode(written))
    assert load_experiment(["experiment=odd"], loaded(module(tmp_path / "conf"))).root.seed == seed


def test_anchors_within_reason_are_read(tmp_path: Path) -> None:
    (tmp_path / "conf/learner").mkdir(parents=True)
    (tmp_path / "conf/learner/strange.yaml").write_bytes(bomb(4))
    assert status(loaded(module(tmp_path / "conf"))) == "ok"


def test_a_plugin_named_like_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bundled one stays, and so does the first of two strangers; neither is to be disabled."""

    def register(register: Registrar) -> None:
        register.component("learner", f"{register.distribution}/learner", object)

    named = entry(module(understudy_register=register), "elsewhere")
    named.name = "ppo"
    first = entry(module(understudy_register=register), "one", "aaa")
    second = entry(module(understudy_register=register), "two", "bbb")
    with_entry(monkeypatch, named, second, first)
    plugins = load()
    assert status(plugins, "ppo") == status(plugins, "stranger") == "ok"
    assert "understudy provides a plugin named 'ppo' already" in status(plugins, "ppo of strange")
    assert "aaa provides a plugin named 'stranger' already" in status(plugins, "stranger of bbb")
    assert {"ppo", "aaa/learner"} <= set(plugins.registry.names("learner"))
    assert {"strange/learner", "bbb/learner"}.isdisjoint(plugins.registry.names("learner"))


@pytest.fixture
def with_stranger(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[ModuleType], None]]:
    """Installs a plugin for the commands."""

    def install(stranger: ModuleType) -> None:
        with_entry(monkeypatch, entry(stranger))
        plugins_module.installed.cache_clear()

    yield install
    plugins_module.installed.cache_clear()


@pytest.mark.parametrize("summary", ["100 % sure", "%s", "%(prog)s %", "%(prog)d"])
def test_a_summary_with_a_per_cent_sign(
    with_stranger: Callable[[ModuleType], None], capsys: pytest.CaptureFixture[str], summary: str
) -> None:
    class Strange(Command):
        def arguments(self, parser: argparse.ArgumentParser) -> None: ...
        def run(self, options: argparse.Namespace) -> int:
            return 0

    def register(register: Registrar) -> None:
        register.component("command", "strange", Strange, summary)
        register.component("command", "strangers all", Strange, summary)

    with_stranger(module(understudy_register=register))
    for words in (
        ["--help"],
        ["strange", "--help"],
        ["strangers", "--help"],
        ["strangers", "all", "--help"],
    ):
        with pytest.raises(SystemExit) as left:
            main(words)
        assert left.value.code == 0
        assert summary in " ".join(capsys.readouterr().out.split())
    assert main(["strange"]) == 0


class Ends(RunObserver):
    """Raises `error` at `event`."""

    def __init__(self, event: str, error: BaseException) -> None:
        self._event, self._error = event, error

    def __getattribute__(self, name: str) -> Any:
        if name == object.__getattribute__(self, "_event"):
            raise object.__getattribute__(self, "_error")
        return object.__getattribute__(self, name)


GO = (
    "experiment=miniature/go",
    "num_worlds=16",
    "learner.rollout_steps=8",
    "learner.minibatches=1",
    "learner.epochs=1",
    "budget.samples=128",
    "evaluation.criterion=null",
    "evaluation.final_episodes=4",
    "evaluation.seconds=0.2",
    "run.video_seconds=0",
)


def observed_by(observer: Callable[[], Any]) -> ModuleType:
    def register(register: Registrar) -> None:
        register.component("observer", "stranger/observer", observer)

    return module(understudy_register=register)


@pytest.mark.parametrize("event", ["started", "iteration", "finished", "judged"])
@pytest.mark.parametrize("error", ENDINGS, ids=reason)
def test_observers_that_end(
    with_stranger: Callable[[ModuleType], None], tmp_path: Path, capsys: pytest.CaptureFixture[str], event: str,
    error: BaseException,
) -> None:  # fmt: skip
    with_stranger(observed_by(lambda: Ends(event, error)))
    assert unharmed(main, ["train", *GO, f"run.dir={tmp_path / 'run'}"]) == 0
    assert f"The observer Ends is left out: {reason(error)}" in capsys.readouterr().err
    assert (tmp_path / "run/evaluation.json").exists()


@pytest.mark.parametrize("given", [5, None, object(), RunObserver, *ENDINGS], ids=repr)
def test_observers_that_are_none(
    with_stranger: Callable[[ModuleType], None], tmp_path: Path, capsys: pytest.CaptureFixture[str], given: Any
) -> None:  # fmt: skip
    def observer() -> Any:
        if isinstance(given, BaseException):
            raise given
        return given

    with_stranger(observed_by(observer))
    assert unharmed(main, ["train", *GO, f"run.dir={tmp_path / 'run'}"]) == 0
    assert (
        "The observer 'stranger/observer' of plugin 'stranger' is left out: "
        in capsys.readouterr().err
    )
    assert (tmp_path / "run/report.html").exists()  # which another's observer makes


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The metadata of a package that is installed: a folder, with the METADATA of stranger 1.0."""
    info = tmp_path / "stranger-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Name: stranger\nVersion: 1.0\n")
    monkeypatch.syspath_prepend(tmp_path)
    plugins_module.installed.cache_clear()
    yield info
    plugins_module.installed.cache_clear()


def test_a_package_whose_entry_points_cannot_be_read_is_named(
    stranger: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every command ended in a traceback that named no package."""
    (stranger / "entry_points.txt").write_bytes(b"\xff\xfe")
    assert main(["plugins"]) == 2
    told = f"The entry points of stranger in {stranger.parent} cannot be read (UnicodeDecodeError"
    assert told in capsys.readouterr().err


def test_a_plugin_of_a_package_whose_name_cannot_be_read(
    stranger: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It works; every command ended in a traceback."""
    (stranger / "METADATA").write_bytes(b"Name: \xff\xfe\nVersion: 1.0\n")
    (stranger / "entry_points.txt").write_text("[understudy]\nodd = odd_plugin_of_stranger\n")
    (stranger.parent / "odd_plugin_of_stranger.py").write_text('"""Brings nothing."""\n')
    assert main(["plugins"]) == 0
    assert "odd" in capsys.readouterr().out


class _Built:
    """Made as parts are."""

    def __init__(self, options: None, *context: Any) -> None: ...


def _lacking(base: type, **what: Any) -> type:
    """A part of a stranger's that derives from `base` and has `what`."""
    return type("Odd", (_Built, base), what)


def _none(*args: Any, **fields: Any) -> None:
    """Whatever is called of a part that is refused before that."""


class _NoDataclass(_Built):
    class Options:
        gain: float = 1.0


def _untyped(position: Any, *, gain: Unknown = 1.0) -> Any:  # type: ignore[name-defined]  # noqa: F821
    """Its option is of a type that is nowhere."""


def of_one_part(monkeypatch: pytest.MonkeyPatch, kind: str, name: str, part: Any) -> ModuleType:
    """A plugin whose tables register `part`, which is imported when it is asked for."""
    stranger, parts = ModuleType("stranger"), ModuleType("stranger.parts")
    vars(parts)["part"] = part
    vars(stranger).update(__package__="stranger", PARTS={kind: {name: ("parts:part", "is odd")}})
    monkeypatch.setitem(sys.modules, "stranger", stranger)
    monkeypatch.setitem(sys.modules, "stranger.parts", parts)
    return stranger


@pytest.mark.parametrize(
    ("slot", "part", "why"),
    [
        ("encoder.state", _lacking(Encoder, encode=_none), "lacks reads, shape, which Encoder declares"),
        ("encoder.state", _lacking(Encoder, reads=(), shape=(2,)), "does not define encode"),
        ("encoder.state", _lacking(Encoder, encode=_none, shape=3, reads=()), "has shape = 3, which must be a Shape"),
        ("encoder.state", _lacking(Encoder, encode=_none, shape=(1,), reads=("position")), "has reads = 'position'"),
        ("encoder.state", _NoDataclass, "has options that cannot be read"),
        ("encoder.state", object, "is not made of (NoneType, Context)"),
        ("encoder.state", 7, "has options that cannot be read"),
        ("fields.odd", _lacking(Fields, compute=_none, reads=()), "lacks provides, which Fields declares"),
        ("fields.odd", _lacking(Fields, compute=_none, reads=(), provides=["odd"]), "has provides = ['odd']"),
        ("fields.odd", _lacking(Fields, compute=_none, reads=(), provides={"odd": 3}), "has provides = {'odd': 3}"),
        ("memory.odd", _lacking(Memory, begin=_none, advance=_none), "lacks keeps, which Memory declares"),
        ("memory.odd", _lacking(Memory, begin=_none, advance=_none, keeps={}, uniforms="x"), "has uniforms = 'x'"),
        ("actuation", _lacking(Actuation, control=_none), "lacks action_space, which Actuation declares"),
        ("initial_states", _lacking(InitialStates), "does not define sample"),
        ("initial_states", _Built, "sample, settle, state_dict, update, varies, which InitialStates declares"),
        ("initial_states", _lacking(InitialStates, sample=_none, varies="drag"), "has varies = 'drag'"),
        ("curriculum", _Built, "which Curriculum declares"),
        ("scene", _Built, "which Scene declares"),
        ("simulator", _Built, "which Simulator declares"),
        ("reward.terms.odd", _Built, "makes what cannot be called"),
        ("reward.terms.odd", _untyped, "NameError: name 'Unknown' is not defined"),
        ("policy", _Built, "which Policy declares"),
        ("learner", _Built, "which Learner declares"),
        ("job", _Built, "which Job declares"),
    ],
)  # fmt: skip
def test_parts_that_are_not_as_their_kind(
    with_stranger: Callable[[ModuleType], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    capsys: pytest.CaptureFixture[str], slot: str, part: Any, why: str,
) -> None:  # fmt: skip
    """Each ended in a traceback from within the kernel; two letters of a field's name were taken for two fields."""
    kind = slot.partition(".")[0]
    with_stranger(of_one_part(monkeypatch, kind, "stranger/odd", part))
    words = [*GO, f"{slot}={{name: stranger/odd}}", f"run.dir={tmp_path / 'run'}"]
    assert unharmed(main, ["train", *words]) == 2
    told = capsys.readouterr().err
    assert f"{kind} 'stranger/odd' of plugin 'stranger' " in told
    assert why in told
    assert "Mend the plugin, or choose another one." in told
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("command", "why"),
    [(object, "lacks arguments"), (None, "is not made of ()"), (lambda: None, "lacks arguments"),
     (Command, "does not define arguments, run")],
)  # fmt: skip
def test_commands_that_are_none(
    with_stranger: Callable[[ModuleType], None], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str], command: Any, why: str,
) -> None:  # fmt: skip
    """Each ended in a traceback."""
    with_stranger(of_one_part(monkeypatch, "command", "odd", command))
    assert unharmed(main, ["odd"]) == 2
    told = capsys.readouterr().err
    assert f"command 'odd' of plugin 'stranger' {why}" in told


@pytest.mark.parametrize(
    "words", [["plugins"], ["tasks"], ["describe", "learner"], ["describe", "learner/stranger/odd"], ["--help"]]
)  # fmt: skip
def test_what_a_plugin_says_of_itself_commands_no_terminal(
    with_stranger: Callable[[ModuleType], None], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str], words: list[str],
) -> None:  # fmt: skip
    """Lists of what there is are read before anything of a plugin is used."""
    commanding = "odd \x1b]0;mine\x07"

    class Learner(_Built):
        __doc__ = commanding

    stranger = of_one_part(monkeypatch, "learner", "stranger/odd", Learner)
    vars(stranger)["PARTS"] = {
        "learner": {"stranger/odd": ("parts:part", commanding)},
        "command": {"odd": ("parts:part", commanding)},
    }
    vars(stranger)["TASKS"] = {"stranger/odd": commanding}
    with_stranger(stranger)
    with contextlib.suppress(SystemExit):  # of --help
        assert main(words) == 0
    told = capsys.readouterr().out
    assert "odd" in told
    assert not {"\x1b", "\x07"} & set(told)


class _Raising:
    """A reward whose options raise what no dataclass should."""

    @dataclass
    class Options:
        size: float = 1.0

        def __post_init__(self) -> None:
            raise KeyError("size")


class _Drawn:
    """A reward with a default that cannot be made."""

    @dataclass
    class Options:
        sizes: list[float] = field(default_factory=lambda: [1 / 0])


class _Untouchable(type):
    def __getattr__(cls, name: str) -> Any:
        raise RuntimeError(name)


class _OfAnOddKind(metaclass=_Untouchable):
    """A reward of which nothing can be asked."""


def _ranged(position: Any) -> Any:
    return position


_ranged.range = "wide"  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("part", "why"),
    [(_Raising, "has options that cannot be read: KeyError: 'size'."),
     (_Drawn, "has options that cannot be read: ZeroDivisionError: division by zero."),
     (_OfAnOddKind, "has options that cannot be read: RuntimeError: __dataclass_fields__."),
     (_ranged, "has a range that is none: ValueError: too many values to unpack")],
)  # fmt: skip
def test_what_a_part_raises_while_it_is_asked_for_is_its_plugins(
    with_stranger: Callable[[ModuleType], None], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str], part: Any, why: str,
) -> None:  # fmt: skip
    """Each ended in a traceback, where the configuration was composed and where the part was described."""
    with_stranger(of_one_part(monkeypatch, "reward", "stranger/odd", part))
    words = [*GO, "reward.terms.odd={name: stranger/odd}", "reward.combine=product"]
    assert unharmed(main, ["config", *words]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"understudy: reward 'stranger/odd' of plugin 'stranger' {why}")
    assert told.rstrip().endswith("Mend the plugin, or choose another one.")
    assert unharmed(main, ["describe", "reward/stranger/odd"]) in (0, 2)


class _Typed(Command):
    """A command that takes a word."""

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("word")

    def run(self, options: argparse.Namespace) -> int:
        return 0


class _Begun(_Typed):
    def __init__(self) -> None:
        raise KeyError("begun")


class _Asked(_Typed):
    def arguments(self, parser: argparse.ArgumentParser) -> None:
        raise NameError("asked")


class _Shared(_Typed):
    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--share", help="100 % of it")


class _Overwriting(_Typed):
    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--overwrite")

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield None


@pytest.mark.parametrize(
    ("command", "why"),
    [(_Begun, "KeyError: 'begun'"), (_Asked, "NameError: asked"), (_Shared, "Error: "),
     (_Overwriting, "ArgumentError: argument --overwrite: conflicting option string: --overwrite")],
)  # fmt: skip
@pytest.mark.parametrize("words", [["odd", "word"], ["odd", "--help"]])
def test_commands_that_raise_before_they_run(
    with_stranger: Callable[[ModuleType], None], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str], command: Any, why: str, words: list[str],
) -> None:  # fmt: skip
    """Each ended in a traceback, the third only when its help was asked for."""
    with_stranger(of_one_part(monkeypatch, "command", "odd", command))
    assert unharmed(main, words) == 2
    told = capsys.readouterr().err
    assert told.startswith("understudy: command 'odd' of plugin 'stranger' cannot be used: ")
    assert why in told
    assert unharmed(main, ["plugins"]) == 0


@pytest.mark.parametrize("value", ["", " ", ":Plugin", "a b"])
def test_an_entry_point_that_names_no_module(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    """It was "AttributeError: 'NoneType' object has no attribute 'group'"."""
    with_entry(monkeypatch, entry(AttributeError("'NoneType' has no attribute 'group'"), value))
    plugins = load(extra=[("fake", fake)])
    said = f"its entry point is {value!r}, which names no module. Write stranger = MODULE there."
    assert_isolated(plugins, said)


def _fails(*args: Any, **options: Any) -> Any:
    raise KeyError("asked")


@pytest.mark.parametrize(
    ("kind", "use"),
    [("character", load_character), ("clip", lambda name, registry: library.load(name, None, registry)),
     ("skill", lambda name, registry: open_skill(name, registry=registry))],
)  # fmt: skip
def test_what_is_asked_for_by_its_name(
    monkeypatch: pytest.MonkeyPatch, kind: str, use: Callable[[str, Registry], Any]
) -> None:
    registry = load(extra=[("stranger", of_one_part(monkeypatch, kind, "odd", _fails))]).registry
    with pytest.raises(PluginError, match=f"^{kind} 'odd' of plugin 'stranger' cannot be used: "):
        use("odd", registry)


@pytest.mark.parametrize("part", [_fails, object])
def test_formats_of_others_are_read_and_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, part: Any
) -> None:
    """All are asked which one a file is of, or an ending, and one that cannot be made is named where none is found."""
    stranger = of_one_part(monkeypatch, "clip_reader", "odd", part)
    vars(stranger)["PARTS"]["clip_writer"] = {"odd": ("parts:part", "is odd")}
    registry = load(extra=[("stranger", stranger)]).registry
    clip = read_clip(write_npz(tmp_path), registry)
    write_clip(clip, tmp_path / "again.npz", registry)
    (tmp_path / "notes.txt").write_text("no motion\n")
    for use in (
        lambda: read_clip(tmp_path / "notes.txt", registry),
        lambda: write_clip(clip, tmp_path / "clip.odd", registry),
    ):
        with pytest.raises(
            FileError, match=r"Plugin 'stranger' did not load: clip_(read|writ)er 'odd'"
        ):
            use()


class _Broken:
    """Raises where `when` says, else is as parts are; of any kind."""

    when = "made"
    reads, shape, provides, keeps, state_fields = ("offset",), (2,), {}, {}, ()  # type: ignore[var-annotated]

    def __init__(self, options: None, *context: Any) -> None:
        if self.when == "made":
            self.fail()

    def fail(self) -> Any:
        return {}["gone"]


class _BrokenEncoder(_Broken, Encoder):
    def encode(self, offset: Any) -> Any:
        return self.fail()


class _BrokenStart(_Broken, InitialStates):
    reads = ()

    def sample(self, streams: Any, **fields: Any) -> Any:
        return self.fail()


class _BrokenLater(_Broken):
    """A reward that fails in the middle of a training."""

    when, calls = "later", 0

    def __call__(self, offset: Any) -> Any:
        type(self).calls += 1
        return self.fail() if self.calls > 5 else offset[:, 0].exp()


def _broken_term(offset: Any) -> Any:
    return {}["gone"]


@pytest.mark.parametrize(
    ("slot", "part"),
    [
        *((slot, _Broken) for slot in ("scene", "simulator", "actuation", "initial_states", "curriculum", "policy",
                                       "learner", "job", "encoder.state", "reward.terms.odd", "measure.odd",
                                       "fields.odd", "memory.odd")),
        ("encoder.state", type("_Late", (_BrokenEncoder,), {"when": "asked"})),
        ("initial_states", type("_Late", (_BrokenStart,), {"when": "asked"})),
        ("reward.terms.odd", _BrokenLater),
        ("termination.terms.odd", _broken_term),
    ],
)  # fmt: skip
def test_what_a_part_raises_is_its_plugins(
    with_stranger: Callable[[ModuleType], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    capsys: pytest.CaptureFixture[str], slot: str, part: Any,
) -> None:  # fmt: skip
    """Each ended in a traceback, while the run was built or later. Whoever mends it is shown where it was."""
    kind = slot.partition(".")[0]
    with_stranger(of_one_part(monkeypatch, kind, "stranger/odd", part))
    words = [*GO, f"{slot}={{name: stranger/odd}}", "reward.combine=sum"]
    assert unharmed(main, ["train", *words, f"run.dir={tmp_path / 'run'}"]) == 2
    told = capsys.readouterr().err
    assert "Traceback" not in told
    last = told.strip().splitlines()[-1]
    assert last.startswith(
        f"understudy: {kind} 'stranger/odd' of plugin 'stranger' raises KeyError: 'gone' ("
    )
    assert f"({Path(__file__).name}, line " in last
    assert "(UNDERSTUDY_TRACEBACK=1 prints the traceback), or choose another one." in last
    assert (tmp_path / "run").exists() == (part is _BrokenLater)
    monkeypatch.setenv("UNDERSTUDY_TRACEBACK", "1")
    assert unharmed(main, ["train", *words, f"run.dir={tmp_path / 'more'}"]) == 2
    assert "Traceback (most recent call last)" in capsys.readouterr().err


def test_what_a_section_or_a_command_raises_is_its_plugins(
    with_stranger: Callable[[ModuleType], None], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    @dataclass
    class Options:
        size: float = 1.0

    def build(options: Options, registry: Registry, inputs: Any) -> Any:
        raise ZeroDivisionError

    class Odd(_Typed):
        def run(self, options: argparse.Namespace) -> int:
            raise NotImplementedError("odd \x1b[31m")

    stranger = of_one_part(monkeypatch, "command", "odd", Odd)
    vars(sys.modules["stranger.parts"]).update(Options=Options, build=build)
    vars(stranger)["SECTIONS"] = {"odd": ("parts:Options", "parts:build")}
    with_stranger(stranger)
    assert unharmed(main, ["train", *GO, "+odd.size=2"]) == 2
    told = capsys.readouterr().err
    assert "section 'odd' of plugin 'stranger' raises ZeroDivisionError (" in told
    assert unharmed(main, ["odd", "word"]) == 2
    told = capsys.readouterr().err
    assert "command 'odd' of plugin 'stranger' raises NotImplementedError: odd [31m (" in told


def test_what_our_own_parts_raise_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    """A defect of ours is no stranger's fault."""

    def defect(offset: Any) -> Any:
        raise KeyError("ours")

    component = load().registry.find("reward", "miniature/near")
    assert component.distribution == "understudy"
    monkeypatch.setattr(
        sys.modules[component.factory.__module__], component.factory.__name__, defect
    )
    plugins_module.installed.cache_clear()
    try:
        with pytest.raises(KeyError, match="ours"):
            main(["train", *GO])
    finally:
        plugins_module.installed.cache_clear()


@pytest.mark.parametrize(
    ("part", "why"),
    [
        (_lacking(Actuation, control=_none, action_space=None), "has action_space = None, which must be a ActionSpace"),
        (_lacking(Actuation, control=_none, action_space=3), "has action_space = 3, which must be a ActionSpace"),
        (_lacking(Actuation, control=_none, action_space=box(2), every="often"), "has every = 'often', which must be a Literal"),
        (_lacking(Actuation, control=_none, action_space=box(2), every=3), "has every = 3, which must be a Literal"),
        (_lacking(Encoder, encode=_none, reads=(), shape=(2,), columns=3), "has columns = 3, which must be a Sequence[str]"),
        (_lacking(Memory, begin=_none, advance=_none, keeps={}, uniforms=-1), "has uniforms = -1, which must be a int"),
        (_lacking(InitialStates, sample=_none, settle=-2), "has settle = -2, which must be a int"),
    ],
)  # fmt: skip
def test_what_a_part_says_of_itself_is_of_its_form(
    with_stranger: Callable[[ModuleType], None], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    part: Any, why: str,
) -> None:  # fmt: skip
    """The first and what is below 0 ended in tracebacks; actions were held for a decision however often was said."""
    slot = next(
        slot
        for slot, base in (
            ("actuation", Actuation),
            ("encoder.state", Encoder),
            ("memory.odd", Memory),
            ("initial_states", InitialStates),
        )
        if issubclass(part, base)
    )
    with_stranger(of_one_part(monkeypatch, slot.partition(".")[0], "stranger/odd", part))
    assert unharmed(main, ["train", *GO, f"{slot}={{name: stranger/odd}}"]) == 2
    assert why in capsys.readouterr().err


def test_a_part_that_gives_fields_as_no_mapping_spoils_no_advice(
    with_stranger: Callable[[ModuleType], None], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    """Its fields were looked through for one that another part lacks, in a traceback."""
    part = type(
        "Odd",
        (_Built, Fields),
        {"provides": property(lambda self: {}), "compute": _none, "reads": ()},
    )
    with_stranger(of_one_part(monkeypatch, "fields", "stranger/odd", part))
    assert unharmed(main, ["train", *GO, "encoder.state.reads={offset: nowhere}"]) == 2
    assert "encoder.state needs the state field 'nowhere'" in capsys.readouterr().err


@pytest.mark.parametrize("moment", ["recognises", "read"])
def test_a_reader_of_clips_that_raises_is_named_and_others_read(
    with_stranger: Callable[[ModuleType], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    capsys: pytest.CaptureFixture[str], moment: str,
) -> None:  # fmt: skip
    """No clip of any format was read any more, in a traceback."""

    class Odd(ClipReader):
        def recognises(self, head: bytes, path: Path) -> bool:
            return {}["gone"] if moment == "recognises" else head.startswith(b"ODD")

        def read(self, path: Path, options: Any = None) -> Any:
            return {}["gone"]

    with_stranger(of_one_part(monkeypatch, "clip_reader", "aaa", Odd))
    (tmp_path / "clip.odd").write_text("ODD")
    own = write_npz(tmp_path)
    assert unharmed(main, ["motion", "check", str(tmp_path / "clip.odd")]) == 2
    told = capsys.readouterr().err
    assert "clip_reader 'aaa' of plugin 'stranger'" in told
    assert "KeyError: 'gone'" in told
    assert unharmed(main, ["motion", "check", str(own)]) in (0, 1)
