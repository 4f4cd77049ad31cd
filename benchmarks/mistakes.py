"""What is answered to mistakes in typing and to questions: ``python benchmarks/mistakes.py [--before CHECKOUT]``.

Types each of ``tests/plugins/inspect/test_mistakes.py`` and of :data:`QUESTIONS` in a process of its own in an
empty folder, and writes what is answered to ``docs/benchmarks/mistakes.json`` under ``after``; with another
version's packages (``pip install --target``), under ``before``. ``docs/mistakes.md`` is made of both.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RECORD, PAGE = ROOT / "docs" / "benchmarks" / "mistakes.json", ROOT / "docs" / "mistakes.md"
#: What people look for, and the command that answers it.
QUESTIONS = {
    "Which runs do I have, and what did they give?": "runs",
    "What differs between two runs?": "compare --help",
    "What must I cite?": "cite spacetime/walk",
    "May I use it commercially?": "licence spacetime/walk --for commercial",
    "Which experiments are there?": "train",
    "What can this part be given?": "describe learner/ppo",
    "What is every value of this training, and what set it?": "config experiment=miniature/go",
    "How do I compare two learners?": "sweep --help",
    "Which of its checkpoints can I look at?": "evaluate --help",
    "How do I get a page that plays offline?": "export --help",
}
MOST = 300  #: characters of an answer that the page has


def mistakes() -> dict[str, str]:
    """By words that are typed wrong, what the answer must have."""
    sys.path.insert(0, str(ROOT / "tests" / "plugins" / "inspect"))
    from test_mistakes import MISTAKES  # pyright: ignore[reportMissingImports]

    return MISTAKES


#: Carries out the commands on its standard input, each in a fork, and prints their statuses and words.
_TYPE = """
import json, os, sys, tempfile
from understudy.command.cli import main
main(["tasks"])
answers = os.dup(1)
for words in json.load(sys.stdin):
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err, tempfile.TemporaryDirectory() as folder:
        process = os.fork()
        if process == 0:
            os.chdir(folder)
            os.mkdir("runs")
            os.dup2(out.fileno(), 1)
            os.dup2(err.fileno(), 2)
            status = 1
            try:
                status = main(words.split())
            except SystemExit as ended:
                status = ended.code or 0
            except BaseException:
                import traceback
                traceback.print_exc()
            sys.stdout.flush(), sys.stderr.flush()
            os._exit(status)
        status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        said = []
        for stream in (out, err):
            stream.seek(0)
            said.append(stream.read().decode(errors="replace"))
        os.write(answers, json.dumps([status, *said]).encode() + b"\\n")
"""


def answers(typed: list[str], packages: str) -> dict[str, dict[str, object]]:
    """By words: the exit status of ``understudy WORDS``, and what it prints."""
    path = os.pathsep.join(filter(None, (packages, os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "PYTHONPATH": path, "COLUMNS": "100", "OMP_NUM_THREADS": "1"}
    ended = subprocess.run(
        [sys.executable, "-c", _TYPE], input=json.dumps(typed), text=True, capture_output=True,
        check=True, env=environment,
    )  # fmt: skip
    found = {}
    rows = [line for line in ended.stdout.splitlines() if line.startswith("[")]
    for words, line in zip(typed, rows, strict=True):
        status, out, err = json.loads(line)
        said = " ".join((err or out if status else out or err).split())
        said = said.replace(f"{packages or ROOT}/", "")
        found[words] = {"status": status, "answer": said.removeprefix("understudy: ")[:2000]}
    return found


def cell(found: dict[str, object] | None) -> str:
    if found is None:
        return "–"
    text = str(found["answer"]).replace("`", "'")
    text = text if len(text) <= MOST else f"{text[:MOST]}…"
    if "Traceback (most recent" in text:
        text = f"a traceback, ending {str(found['answer'])[-120:]}"
    status = "" if found["status"] in (0, 2) else f"(status {found['status']}) "
    for sign in "\\*_[]<>|{}":
        text = text.replace(sign, f"\\{sign}")
    return status + text


def page(record: dict[str, dict[str, dict[str, object]]]) -> str:
    before, after = record.get("before", {}), record.get("after", {})
    lines = [
        "# Mistakes and questions", "",
        "What the command line answers to words that are typed wrong, and to questions of a first day. *Before* is",
        "the version of a stranger's first try; both columns are what `python benchmarks/mistakes.py` printed, cut",
        f"at {MOST} characters. Each answer's right part is a test (`tests/plugins/inspect/test_mistakes.py`).", "",
        "## Mistakes", "", "<!-- no record: made whole by benchmarks/mistakes.py from benchmarks/mistakes.json -->",
        "| typed | before | now |", "| --- | --- | --- |",
    ]  # fmt: skip
    lines += [f"| `{t}` | {cell(before.get(t))} | {cell(after.get(t))} |" for t in mistakes()]
    lines += [
        "", "## Questions", "",
        "<!-- no record: made whole by benchmarks/mistakes.py from benchmarks/mistakes.json -->",
        "| question | typed | before | now |", "| --- | --- | --- | --- |",
    ]  # fmt: skip
    lines += [
        f"| {q} | `{t}` | {cell(before.get(t))} | {cell(after.get(t))} |"
        for q, t in QUESTIONS.items()
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    before = sys.argv[2] if sys.argv[1:2] == ["--before"] else ""
    record = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    typed = [*mistakes(), *QUESTIONS.values()]
    record["before" if before else "after"] = answers(typed, before)
    RECORD.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n")
    PAGE.write_text(page(record))


if __name__ == "__main__":
    main()
