"""Fault 20: checkpoints whose seal is right and whose content is not what this run's would be.

Whatever one field is replaced by, resuming and evaluating end with one sentence and status 2, and write
nothing; or the field makes no difference to them.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from worlds import PADDLE_TASK, SMALL, all_plugins, make_training

from understudy.command.cli import main
from understudy.records import checkpoint
from understudy.setup import composition
from understudy.setup import plugins as setup_plugins
from understudy_training import workflow

GONE = object()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A run in the middle of its budget, with an optimiser that has taken steps."""
    folder, plugins = tmp_path_factory.mktemp("wrong") / "run", all_plugins()
    more = ("budget.samples=512", "evaluation.final_episodes=4", "evaluation.episodes=4",
            "evaluation.seconds=0.5", "run.video_seconds=0")  # fmt: skip
    training = make_training(plugins, [*PADDLE_TASK, *SMALL, *more], folder)
    for _ in range(3):
        training.iterate()
    training.save()
    assert training.run is not None
    training.run.unlock()
    with pytest.MonkeyPatch.context() as patch:
        for module in (setup_plugins, composition, workflow):
            patch.setattr(module, "installed", lambda: plugins)
        yield folder


def odd(value: Any) -> list[Any]:
    """What may stand in the place of `value` and is not like it."""
    if isinstance(value, Tensor):
        others: list[Any] = [torch.cat([value.reshape(-1), value.reshape(-1)[:1]]), "text", 1.5, {}]
        others.append(value.bool() if value.dtype != torch.bool else value.float())
        if value.is_floating_point() and value.numel():
            spoiled = value.clone()
            spoiled.view(-1)[0] = float("nan")
            others.append(spoiled)
        return [*others, GONE]
    if isinstance(value, dict):
        return [[], "text", 3, GONE]
    if isinstance(value, (int, float)):
        return ["text", [1], torch.ones(2), float("nan"), {}, GONE, -1 - abs(value), 2**63]
    return [3, {"a": 1}, GONE]


def places(state: Any, where: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    if where:
        yield where, state
    if isinstance(state, dict):
        for name, value in state.items():
            yield from places(value, (*where, name))


def changed(state: Any, where: tuple[str, ...], value: Any) -> Any:
    state = copy.copy(state)
    name, *deeper = where
    if deeper:
        state[name] = changed(state[name], tuple(deeper), value)
    elif value is GONE:
        del state[name]
    else:
        state[name] = value
    return state


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p): p.read_bytes() for p in folder.rglob("*") if p.is_file() and p.name != ".lock"}


def refused(run: Path, capsys: pytest.CaptureFixture[str], command: str) -> bool:
    """Whether the command refuses the run as it should; a defect would be raised."""
    before = contents(run)
    status = main([command, str(run)])
    lines = capsys.readouterr().err.strip().splitlines()
    if status == 0:
        return False
    assert status == 2, lines
    assert lines[-1].startswith("understudy: ")
    assert [line for line in lines if "Traceback" in line] == []
    assert len(lines[-1]) < 600
    assert contents(run) == before, "nothing is written"
    return True


def cases(state: Any) -> list[tuple[tuple[str, ...], Any]]:
    found = [(where, other) for where, value in places(state) for other in odd(value)]
    # checkpoints from before there was such a thing lack it, and are read; evaluations are set back before the start
    fine = {(("progress", "pending"), str(GONE)), (("progress", "evaluated_at"), "-1")}
    return [(where, other) for where, other in found if (where, str(other)) not in fine]


def check(run: Path, capsys: pytest.CaptureFixture[str], chosen: slice) -> None:
    newest = checkpoint.newest(run / "checkpoints")[0]
    state, meta = checkpoint.load(newest)
    before, accepted = contents(run), []
    found = cases(state)[chosen]
    assert len(found) > 20
    for where, other in found:
        # evaluating takes nothing else
        for command in (
            ("resume", "evaluate") if where[0] in ("policy", "progress") else ("resume",)
        ):
            checkpoint.save(newest, changed(state, where, other), meta)
            if not refused(run, capsys, command):
                accepted.append((command, "/".join(where), str(other)[:40]))
            for path in set(contents(run)) - set(before):
                Path(path).unlink()
            for path, data in before.items():
                Path(path).write_bytes(data)
    assert not accepted, accepted


def test_every_tenth_field(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check(run, capsys, slice(None, None, 10))


@pytest.mark.slow
def test_every_field(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check(run, capsys, slice(None))


@pytest.mark.parametrize("meta", [3, None, "text", {"config": 3}, {"versions": [1]}, {}])
def test_what_is_written_beside_the_state(
    run: Path, meta: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is compared and told, and nothing else; of another type it is damage."""
    newest = checkpoint.newest(run / "checkpoints")[0]
    before = newest.with_suffix(".json").read_bytes()
    content = checkpoint.read_sealed(newest.with_suffix(".json"))
    newest.with_suffix(".json").write_bytes(checkpoint._sealed({**content, "meta": meta}))
    status = main(["evaluate", str(run)])
    lines = capsys.readouterr().err.strip().splitlines()
    newest.with_suffix(".json").write_bytes(before)
    assert status == (0 if isinstance(meta, dict) else 2), lines
    if status == 2:
        assert lines[-1].startswith("understudy: ")
        assert not (run / "evaluation.json").exists()
    (run / "evaluation.json").unlink(missing_ok=True)
