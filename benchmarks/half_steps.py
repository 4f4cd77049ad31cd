"""Which packaged skills live off their time step: each judged again at half of it, from the same starts.

``python benchmarks/half_steps.py`` unpacks every skill that ships, runs `understudy evaluate` on it and writes a line of JSON
each to ``docs/benchmarks/half_steps.jsonl``, from which ``make figures`` writes the table in ``docs/benchmarks/README.md``.
Run folders and files of packed skills (.json) are judged in place of these where given with ``--skills``. With overrides, as of where
episodes begin, ``--out`` names another file: ``sitting/turn_starts.jsonl`` is of ``'initial_states.span=[0,0.25]'``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from understudy_skills.as_run import unpack
from understudy_skills.skill import names, open_skill

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "half_steps.jsonl"
WORDS = {
    "independent": "no",
    "depends": "**yes**",
    "undecided": "undecided",
}


def row(name: str, episodes: int, overrides: list[str]) -> dict[str, Any]:
    """What `understudy evaluate` says of the skill `name`, on one thread."""
    skill = open_skill(name)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "run"
        unpack(skill, folder)
        command = [sys.executable, "-m", "understudy.command.cli", "evaluate", str(folder)]
        words = [f"episodes={episodes}", "device=cpu", "simulator.threads=1", *overrides]
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        began = time.monotonic()
        done = subprocess.run(
            [*command, *words], env=environment, capture_output=True, text=True, check=False
        )
    if done.returncode:
        return {"skill": name, "wrong": done.stderr.strip().splitlines()[-1]}
    found = json.loads(done.stdout)
    finer = found["half_step"]
    return {
        "skill": name,
        **({"overrides": overrides} if overrides else {}),
        "when": time.strftime("%Y-%m-%d"),
        "seed": 0,
        "episodes": found["episodes"],
        "wall_seconds": round(time.monotonic() - began, 1),
        "success": found["success"],
        "physics_hz": finer["physics_hz"] / 2,
        "rates": f"{finer['physics_hz'] / 2:g} and {finer['physics_hz']:g} Hz",
        "success_rate": found["success_rate"],
        "half_step": finer,
        "depends": WORDS[finer["verdict"]] if "verdict" in finer else "–",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--skills", nargs="+", help="those alone; what is not packaged is not saved"
    )
    parser.add_argument("--episodes", type=int, default=128, help="of each skill and time step")
    parser.add_argument("--workers", type=int, default=1, help="skills at once, a thread each")
    parser.add_argument("--out", type=Path, default=RESULTS, help="where records are kept")
    parser.add_argument("overrides", nargs="*", help="of every evaluation")
    given = parser.parse_args()
    with ThreadPoolExecutor(given.workers) as pool:
        jobs = given.skills or names()
        waiting = [pool.submit(row, one, given.episodes, given.overrides) for one in jobs]
        for future in as_completed(waiting):
            found = future.result()
            print(line := json.dumps(found), flush=True)
            if "wrong" not in found and found["skill"] in names():
                lines = (
                    given.out.read_text(encoding="utf-8").splitlines() if given.out.exists() else []
                )
                kept = {json.loads(one)["skill"]: one for one in lines} | {found["skill"]: line}
                given.out.write_text(
                    "".join(kept[one] + "\n" for one in names() if one in kept), encoding="utf-8"
                )


if __name__ == "__main__":
    main()
