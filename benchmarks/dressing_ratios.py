"""Area ratios of the shirt in episodes that go well and that go wrong: of what `reward=dressing/deformation` takes its w_mid.

``python benchmarks/dressing_ratios.py`` plays the kept policies by their mode: grip, tuck and sleeve (its hand in the mouth),
whose episodes go well, and the sleeve's from under the hem, where the arm goes through the cloth. It writes to
``docs/benchmarks/dressing_ratios.jsonl`` how many decisions have which largest area ratio, of episodes that met their criterion
with no bone through the cloth, and of the others, and draws ``docs/media/dressing-ratios.svg``. `--draw` draws alone.
"""

from __future__ import annotations

import argparse
import datetime
import itertools
import json

import torch
from dressing_replay import KEPT, STAGES, WORDS

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment

RECORD = KEPT / "dressing_ratios.jsonl"
PICTURE = KEPT.parent / "media" / "dressing-ratios.svg"
SLEEVE = "{{run: {kept}/shirt_sleeve_within.json, until: {{field: dressed, at_least: 1.0}}, seconds: 4.0}}"
#: What is played, and what it begins in.
PLAYED = {
    "grip": (STAGES["grip"], "on_shoulders"),
    "tuck": (STAGES["tuck"], "held"),
    "sleeve, from its mouth": (SLEEVE, "in_sleeve"),
    "sleeve, from under the hem": (SLEEVE, "tucked"),
}
#: Of area ratios, the last one open.
BINS = [*(1.0 + 0.25 * k for k in range(21)), float("inf")]


def ratios(stage: str, worn: str, worlds: int) -> tuple[torch.Tensor, torch.Tensor]:
    """(T, N) the largest area ratio of each decision, nan once the episode is over, and (N,) which went well."""
    words = [*WORDS, f"initial_states.worn={worn}", f"actuation.stages=[{stage.format(kept=KEPT / 'dressing')}]"]  # fmt: skip
    environment = build_environment(
        load_experiment([*words, f"num_worlds={worlds}"]), evaluating=True
    ).environment
    environment.reset(seed=1)
    table, found = environment.table, []
    playing, well, through = (torch.full((worlds,), value) for value in (True, False, False))
    while playing.any():
        step = environment.advance(torch.zeros(worlds, environment.action_size))
        found.append(torch.where(playing, table["area_ratio"], torch.nan))
        through |= playing & (table["pierced"] > 0)
        well |= playing & step.terminated & ~step.failed
        playing &= ~step.ended
        environment.begin(step.ended)
    environment.close()
    return torch.stack(found), well & ~through


def draw(rows: list[dict[str, list[int]]]) -> None:
    """Bars of shares, by bin, of decisions that go well, above, and wrong, below."""
    sums = {how: [sum(counts) for counts in zip(*(row[how] for row in rows), strict=True)] for how in ("well", "wrong")}  # fmt: skip
    parts = []
    for (how, counts), colour, top in zip(sums.items(), ("#2a7", "#c43"), (0, 110), strict=True):
        total = max(1, sum(counts))
        parts.append(f'<text x="4" y="{top + 14}">{how}: {total} decisions</text>')
        for k, count in enumerate(counts):
            height = 80 * count / max(*counts, 1)
            parts.append(f'<rect x="{10 + 22 * k}" y="{top + 100 - height:.1f}" width="20" height="{height:.1f}" fill="{colour}"/>')  # fmt: skip
    labels = [f'<text x="{10 + 22 * k}" y="228">{BINS[k]:g}</text>' for k in range(0, len(BINS) - 1, 4)]  # fmt: skip
    PICTURE.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {20 + 22 * (len(BINS) - 1)} 236" font-family="sans-serif" font-size="11">'
        '<rect width="100%" height="100%" fill="#fff"/>' + "".join([*parts, *labels]) + "</svg>\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--draw", action="store_true")
    options = parser.parse_args()
    if not options.draw:
        rows = []
        for name, (stage, worn) in PLAYED.items():
            found, well = ratios(stage, worn, options.worlds)
            row = {"played": name, "when": datetime.date.today().isoformat(), "machine": "one busy CPU core", "edge": 0.03,
                   "worlds": options.worlds, "went_well": int(well.sum()), "bins": BINS[:-1]}  # fmt: skip
            for how, worlds in (("well", well), ("wrong", ~well)):
                these = found[:, worlds][~found[:, worlds].isnan()]
                row[how] = [int(((these >= a) & (these < b)).sum()) for a, b in itertools.pairwise(BINS)]  # fmt: skip
                row[f"{how}_largest"] = [round(float(x), 2) for x in found[:, worlds].nan_to_num(0.0).amax(dim=0)]  # fmt: skip
            print(row, flush=True)
            rows.append(row)
        RECORD.write_text("".join(json.dumps(row) + "\n" for row in rows))
    draw([json.loads(line) for line in RECORD.read_text().splitlines()])


if __name__ == "__main__":
    main()
