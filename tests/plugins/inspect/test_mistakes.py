"""What one types wrong on the first day is answered in one sentence that says what to type instead."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from understudy.command.cli import main

WALK = "experiment=spacetime/walk"

MISTAKES = {
    f"trian {WALK}": "no command 'trian'. Did you mean 'train'?",
    "motion chek x": "no command 'chek'. Did you mean 'check'?",
    "help": "Known: amorphous, cite, compare, completion, config,",
    "train spacetime/walk": "Write experiment=spacetime/walk.",
    "train --seed 3": "There is no option --seed. Write seed=3.",
    f"train {WALK} --learner=trpo": "Write learner=trpo.",
    f"train {WALK} seed = 3": "'seed' sets nothing. Write KEY=VALUE, without spaces.",
    f"train {WALK} seed=1,2,3": "several values and a run takes one. A list is written [1,2,3], a text with commas ",
    f"train {WALK},deepmimic/walk": "compared by `understudy sweep`",
    f"train {WALK} seed=three": "seed='three' is not possible: it takes a whole number.",
    "train experiment=walk": "'deepmimic/walk' or 'morphology/walk' or 'sitting/walk' or 'spacetime/walk'?",
    "train experiment=Spacetime/Walk": "Did you mean 'spacetime/walk'?",
    "train experiment=": "spacetime/{backflip, cartwheel,",
    "train experimnt=spacetime/walk": "Did you mean 'experiment'?",
    "train task=spacetime/walk": "policy is not set. Choose an experiment",
    f"train {WALK} learner=sac": "Known: imagination, ppo, trpo, amorphous/{many_worlds, ppo}, ",
    f"train {WALK} leaner=ppo": "Did you mean 'learner'?",
    f"train {WALK} learner.lr=1e-3": "weight_decay.",
    f"train {WALK} learner=PPO": "There is no learner=PPO. Did you mean 'ppo'?",
    f"train {WALK} learner/gamma=0.9": "A part's option has dots: learner.gamma=VALUE.",
    f"train {WALK} {'a' * 300}=3": "it has 300 characters.",
    f"train {WALK} =3": "'=3' sets nothing. Write KEY=VALUE, without spaces.",
    f"train --dry-run {WALK}": "There is no option --dry-run. Write KEY=VALUE.",
    "export spacetime/walk walk.fbx": "no format is written to '.fbx' files. Known: .bvh, ",
    f"train {WALK} lr=1e-3": "An option of a part is written as PART.lr.",
    f"train {WALK} samples=1000": "Did you mean 'budget.samples'?",
    f"train {WALK} worlds=16": "Did you mean 'num_worlds'?",
    f"train {WALK} budget=100000": "it takes a mapping of samples, minutes, usual_samples.",
    f"train {WALK} learner.gamma=2": "learner.gamma=2.0 is not possible: it must be at most 1.",
    f"train {WALK} device=gpu": "Use cpu, cuda, or cuda:1.",
    f"train {WALK} scene.character=humanoyd": "Did you mean 'humanoid'?",
    f"train {WALK} termination.terms.com.size=[0.1": "cannot be read. Check brackets and quotes.",
    f"train {WALK} +foo=3": "no configuration key 'foo'",
    f"train {WALK} motion.file=nosuch.npz": "Clip nosuch.npz: there is no such file.",
    "evaluate": "arguments are required: run. See `understudy evaluate --help`.",
    "evaluate nosuch": "nosuch is no run folder: it has no run.json. Name one, as runs/NAME.",
    f"sweep {WALK}": "Give variants={NAME: [KEY=VALUE]}, ablation=…, search=… or outer_loop=…. Known: ",
    f"sweep {WALK} --dry": "There is no option --dry. Write KEY=VALUE. See `understudy sweep --help`.",
    f"train {WALK} -m": "-m is Hydra's own. Several values: `understudy sweep experiment=NAME",
    f"train {WALK} seed=1,2 --multirun": "--multirun is Hydra's own. Several values: `understudy sweep",
    f"train {WALK} --cfg job": "--cfg is Hydra's own. `understudy config experiment=NAME KEY=VALUE` prints",
    f"train {WALK} --cfg=job": "`understudy config experiment=NAME KEY=VALUE` prints",
    f"train {WALK} --info": "`understudy config experiment=NAME KEY=VALUE` prints",
    "train --config-name walk": "An experiment is chosen by experiment=NAME",
    "train -cn=walk": "An experiment is chosen by experiment=NAME",
    "train --hydra-help": "`understudy train --help` has what there is.",
    f"train {WALK} learner.gamma=high": "learner.gamma='high' is not possible: it takes a number.",
    f"train {WALK} scene.self_collision=maybe": "it takes true or false.",
    f"train {WALK} policy.feedback.hidden=64": "it takes a list of whole numbers.",
    f"train {WALK} policy.feedback.observation=3": "Add encoder.3={name: …}",
    f"train {WALK} policy.feedback.observation=[state,extra]": "Add encoder.extra={name: …}",
    "compare one": "A comparison is of two runs or more: understudy compare RUN RUN.",
    "runs nosuch": "nosuch is no folder. Name one that holds runs.",
    "licence nosuch": "nosuch is no run folder",
    "cite nosuch": "nosuch is no run folder",
    "licence spacetime/walk --for profit": "invalid choice: 'profit'",
    "tasks foo": "'foo' is not taken here. See `understudy tasks --help`.",
    "describe": "arguments are required: part.",
    "describe ppp": "There is nothing called 'ppp'. Write KIND/NAME, as in learner/ppo.",
    "describe learner/pop": "There is no learner 'pop'. Did you mean 'ppo'?",
    "completion csh": "invalid choice: 'csh'",
    "reproduce table_3_1": "There is no table 'table_3_1'. Did you mean 'spacetime/table_3_1'?",
    "reproduce spacetime/table_3_1 --rows walkk": "--rows: there is no 'walkk'. Did you mean 'walk'?",
    "reproduce spacetime/table_3_1 --seeds one": "'one' is not possible: whole numbers, as in 0,1.",
    "reproduce spacetime/table_3_1 seeds=[0,1]": "write --seeds 0,1.",
    "reproduce spacetime/table_3_1 experiment=spacetime/run": "the table sets it. Choose by --rows and --columns.",
    "reproduce spacetime/table_3_1 --card seed=1": "the table sets it. Choose by --seeds.",
    "reproduce spacetime/table_3_1 --card num_worlds=8": "--card trains nothing.",
    "runs --jsn": "'--jsn' is not taken here. See `understudy runs --help`.",
    "compare": "The following arguments are required: RUN.",
    "license spacetime/walk": "Did you mean 'licence'?",
    "cite nosuch.json": "There is no skill 'nosuch.json'. Known: ",
    "new paper My-Paper": "Use small letters, digits and _, as in my_paper.",
    "new paper spacetime": "There is a plugin 'spacetime' already.",
    "new plugn balance": "There is no command 'plugn'. Did you mean 'plugin'?",
    "motion check walk --fix": "Argument --fix: expected one argument.",
    "motion check walk --character nosuch": "There is no character 'nosuch'. Known: ",
    "motion retarget walk humanoid out.xyz": "no format is written to '.xyz' files.",
    "motion retarget walk humanoid out.npz --map left_knee": "it is OURS=THEIRS, two joints.",
    "motion export walk humanoid out.csv --for isaac": "invalid choice: 'isaac'",
    "replay nosuch": "nosuch has no step to repeat",
    "resume spacetime/walk": "`understudy play spacetime/walk --unpack runs/spacetime-walk` makes a run",
    "resume nosuch": "nosuch is no run folder",
    f"sweep {WALK} variants={{a:[]}} seeds=3": "outer_loop.seeds=3 is not possible: it takes a list of whole numbers.",
    f"sweep {WALK} variants={{a:[],b:[learner.gamma=2]}}": "Variant 'b' cannot be run: learner.gamma=2.0",
    "sweep search=cmfbo/toy outer_loop.parameters.learner.epochs.low=2": "'outer_loop.parameters={learner.epochs: …}'.",
    "sweep search=miniature/cmfbo outer_loop.high.actuation.strength=5": "'outer_loop.high={actuation.strength: …}'.",
    f"train {WALK} start=nosuch": "it takes a mapping of run, parts.",
    f"train {WALK} start.run=nosuch start.parts=[weights]": "start.parts[0]='weights' is not possible. Known: actor,",
    f"train {WALK} learner.gamma=nan": "learner.gamma=nan is not possible; give a finite number.",
}


@pytest.mark.parametrize("typed", MISTAKES)
def test_one_sentence(
    typed: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(typed.split()) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("understudy: ")
    assert captured.err.count("\n") == 1
    assert MISTAKES[typed] in captured.err
    assert ", …" not in captured.err, "lists are whole"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("variable", "value", "answer"),
    [
        ("UNDERSTUDY_PLUGINS", "nope", "UNDERSTUDY_PLUGINS names 'nope', which is no installed plugin."),
        ("UNDERSTUDY_PLUGINS", "spacetme,ppo", "Did you mean 'spacetime'?"),
        ("UNDERSTUDY_DISABLE_PLUGINS", "report;sweeps", "names 'report;sweeps'"),
    ],
)  # fmt: skip
def test_variables_that_name_no_plugin(
    variable: str, value: str, answer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(variable, value)
    command = [sys.executable, "-m", "understudy", "tasks"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.startswith("understudy: ")
    assert ended.stderr.count("\n") == 1
    assert answer in ended.stderr


def test_train_alone_lists_experiments(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train"]) == 0, "the list is what was asked for"
    lines = capsys.readouterr().out.splitlines()
    assert "spacetime" in lines
    walk = next(line for line in lines if line.startswith("  spacetime/walk "))
    assert walk.endswith("survival reward (thesis, section 3.5.1; at most 4.08 M samples)")
    named = [line.split(maxsplit=1) for line in lines if line.startswith("  ")]
    assert [words for words in named if len(words) < 2] == [], "each says what it is"
    assert lines[-1] == "Train one: understudy train experiment=NAME"


def test_help_names_the_keys_that_one_types(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([])
    assert ended.value.code == 0
    shown = capsys.readouterr().out
    for key in (
        "experiment=",
        "seed=3",
        "num_worlds=",
        "budget.samples=",
        "motion.file=",
        "run.dir=",
    ):
        assert key in shown
