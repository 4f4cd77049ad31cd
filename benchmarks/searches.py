"""Searches on functions with known optima: simple regret at equal cost, no training anywhere.

``python benchmarks/searches.py --seeds 20 --jobs 15`` runs random search, GP-UCB, BOCA and CMFBO through
``OuterLoop.ask`` and ``tell``, and BoTorch's own UCB as GP-UCB's peer, prints a table and appends a
line per function to ``docs/benchmarks/searches.jsonl``. ``--ask`` times an ask with 60 trials of 12
parameters instead.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import botorch
import gpytorch
import torch
from botorch.acquisition import UpperConfidenceBound
from botorch.fit import fit_gpytorch_mll
from botorch.models import SingleTaskGP
from botorch.optim import optimize_acqf
from botorch.test_functions.multi_fidelity import AugmentedBranin, AugmentedHartmann
from gpytorch.mlls import ExactMarginalLogLikelihood
from rows import append
from scipy import stats
from torch import Tensor

from understudy.options import make_options
from understudy_bayes import draws
from understudy_bayes.acquisition import beta
from understudy_bayes.boca import BOCA
from understudy_bayes.gp_ucb import GPUCB
from understudy_bayes.random_search import RandomSearch
from understudy_cmfbo.cmfbo import CMFBO
from understudy_sweeps.loops import OuterLoop, Report, Trial

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "searches.jsonl"


def cost(z: float) -> float:
    """Of a trial at fidelity z, in units of a whole one; ``--cheapest`` is that of the easiest.

    Measured on DeepMimic's walk 0.59, on morphology's walker 0.81 (the seven and eight trials of figures 6.5 and 6.3
    that CMFBO and GP-UCB made at the same points); the thesis has 0.25 (20 and 80 minutes, 6.4.2).
    """
    cheapest = float(os.environ.get("CHEAPEST", "0.1"))
    return cheapest + (1 - cheapest) * z


# -------------------------------------------------------------------- functions


@dataclass(frozen=True)
class Function:
    """f(u, z) of u (d,) in the unit cube, to be maximised at z = 1; its maximum there is known."""

    d: int
    value: Callable[[Tensor, float], float]
    maximum: float
    budget: float  #: whole trials
    noise: float = 0.0  #: standard deviation of what a search is told


def branin(u: Tensor, z: float) -> float:
    """BoTorch's augmented Branin; low fidelities move its valley."""
    x = torch.cat([u * 15 + torch.tensor([-5.0, 0.0]), torch.tensor([z])]).double()
    return float(AugmentedBranin(negate=True, dtype=torch.double)(x))


def hartmann(u: Tensor, z: float) -> float:
    """BoTorch's augmented Hartmann-6; low fidelities lower one of its hills a little."""
    x = torch.cat([u.double(), torch.tensor([z]).double()])
    return float(AugmentedHartmann(negate=True, dtype=torch.double)(x))


#: Where `disagree` is highest at every z, and a hill that is not as high.
_TOP, _SECOND = torch.tensor([0.7, 0.3, 0.6, 0.2]), torch.tensor([0.2, 0.8, 0.3, 0.7])


def disagree(u: Tensor, z: float) -> float:
    """Fidelities that disagree in value and agree in where the optimum lies (figure 6.2b).

    With q(x) the two hills, easy tasks shift (½(1-z)), scale (0.4 + 0.6z) and warp (q^(½+½z)) the
    values, and away from the optimum they go up and down with z unpredictably.
    """
    hill = lambda centre: float(torch.exp(-((u - centre) ** 2).sum() / (2 * 0.25**2)))  # noqa: E731
    q = min(hill(_TOP) + 0.6 * hill(_SECOND), 1.0)
    ripple = math.sin(5 * float(u.sum()) + 7 * z) * math.cos(6 * float(u[0] - u[1]) - 4 * z)
    return 0.5 * (1 - z) + (0.4 + 0.6 * z) * q ** (0.5 + 0.5 * z) + 0.15 * (1 - q) * ripple


def training(u: Tensor, z: float) -> float:
    """As trainings are by eq. 6.5: whoever is good enough for the task learns it, sooner the better it is; all others
    have next to nothing. Seven parameters of which some hardly matter; a harder task asks for more."""
    far = (u - torch.tensor([0.6, 0.3, 0.7, 0.4, 0.5, 0.5, 0.5])) ** 2
    good = math.exp(
        -float(far @ torch.tensor([1.0, 0.8, 0.6, 0.4, 0.2, 0.1, 0.05])) / (2 * 0.45**2)
    )
    learned = 1 / (1 + math.exp(-(good - 0.25 - 0.2 * z) / 0.03))
    return learned * math.exp(-0.5 * (1 - good))


FUNCTIONS = {
    "branin": Function(2, branin, -0.397887, 20.0),
    "hartmann6": Function(6, hartmann, 3.32237, 40.0),
    "disagree": Function(4, disagree, 1.0, 20.0),
    "training": Function(7, training, 1.0, 14.0, noise=0.05),
}


# --------------------------------------------------------------------- searches

#: What each trial of a search was at, gave and was told: u (d,), z, y, y with noise.
Found = list[tuple[Tensor, float, float, float]]


def through(loop: OuterLoop, function: Function, names: Sequence[str], seed: int) -> Found:
    """Carry the search out, by ask and tell."""
    found: Found = []
    luck = torch.Generator().manual_seed(seed)
    while (trial := loop.ask(len(found))) is not None:
        u = torch.tensor([trial.point[name] for name in names])
        z = 1.0 if trial.fidelity is None else trial.fidelity
        y = function.value(u, z)
        told = y + function.noise * float(torch.randn((), generator=luck))
        loop.tell(Report(trial.key, "ok", told, cost=cost(z)))
        found.append((u, z, y, told))
    return found


def search(method: type) -> Callable[[Function, int], Found]:
    def run(function: Function, seed: int) -> Found:
        names = [f"x.x{i}" for i in range(function.d)]
        given = {"parameters": {name: {"low": 0.0, "high": 1.0} for name in names}}
        given |= {
            "budget": function.budget,
            **({"cost_ratio": cost(0.0)} if method is BOCA else {}),
        }
        if os.environ.get("AFTER_INITIAL"):
            given |= {"initial": 8, "initial_counts": False}
        if method is CMFBO:
            given |= json.loads(os.environ.get("CMFBO_OPTIONS", "{}"))
        options = make_options(method.Options, given, "search")
        return through(method(options, seed), function, names, seed)

    return run


def botorch_ucb(function: Function, seed: int) -> Found:
    """BoTorch's UCB from the same first trials and with the same β: its model, fit and maximiser."""
    torch.manual_seed(seed)
    d, found = function.d, list[tuple[Tensor, float, float, float]]()
    bounds = torch.stack([torch.zeros(d), torch.ones(d)]).double()
    while len(found) < function.budget:
        t = len(found) + 1
        if t <= 8:
            u = torch.tensor(draws.spread(seed, t - 1, d))
        else:
            x = torch.stack([u for u, *_ in found]).double()
            y = torch.tensor([[told] for *_, told in found], dtype=torch.float64)
            model = SingleTaskGP(x, y)
            fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
            bound = UpperConfidenceBound(model, beta=beta(d, t))
            u = optimize_acqf(bound, bounds, q=1, num_restarts=8, raw_samples=512)[0][0]
        u = u.float()
        y = function.value(u, 1.0)
        found.append((u, 1.0, y, y + function.noise * float(torch.randn(()))))
    return found


SEARCHES: dict[str, Callable[[Function, int], Found]] = {
    "random_search": search(RandomSearch),
    "gp_ucb": search(GPUCB),
    "botorch_ucb": botorch_ucb,
    "boca": search(BOCA),
    "cmfbo": search(CMFBO),
}

#: Shares of the budget at which the regret is taken.
SHARES = (0.25, 0.5, 0.75, 1.0)


def regrets(function: Function, found: Found) -> list[float]:
    """Simple regret once each share of the budget is spent: the maximum less the value of the whole trial that
    was told the most; before the first, of whatever trial was."""
    result, free = [], 8 if os.environ.get("AFTER_INITIAL") else 0
    for share in SHARES:
        spent, seen = 0.0, found[:1]
        for number, trial in enumerate(found):
            spent += cost(trial[1]) if number >= free else 0.0
            if spent > share * function.budget + 1e-9:
                break
            seen = [*seen, trial]
        answer = max([t for t in seen if t[1] >= 1] or seen, key=lambda t: t[3])
        result.append(function.maximum - function.value(answer[0], 1.0))
    return result


def one(job: tuple[str, str, int]) -> tuple[list[float], int, int, float]:
    """Regrets, trials, whole trials and seconds of one search."""
    torch.set_num_threads(1)
    name, method, seed = job
    began = time.perf_counter()
    found = SEARCHES[method](FUNCTIONS[name], seed)
    seconds = time.perf_counter() - began
    whole = sum(z >= 1 for _, z, *_ in found)
    return regrets(FUNCTIONS[name], found), len(found), whole, seconds


# ---------------------------------------------------------------------- results


def interval(values: Sequence[float]) -> tuple[float, float]:
    """Mean, and half the width of its 95 % interval (Student's t)."""
    n = len(values)
    half = (
        stats.t.ppf(0.975, n - 1) * statistics.stdev(values) / math.sqrt(n) if n > 1 else math.nan
    )
    return statistics.fmean(values), float(half)


def compare(
    names: Sequence[str], methods: Sequence[str], seeds: Sequence[int], jobs: int, save: bool
) -> None:
    one_thread: dict[str, str] = dict.fromkeys(
        ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"
    )
    os.environ.update(one_thread)  # of the processes to come
    work = [(f, m, s) for f in names for m in methods for s in seeds]
    work.sort(key=lambda job: -FUNCTIONS[job[0]].budget)  # the long ones first
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        results = {}
        for job, result in zip(work, pool.map(one, work), strict=True):
            results[job] = result
            print(*job, *(f"{r:.4f}" for r in result[0]), file=sys.stderr, flush=True)
    for name in names:
        found = {m: [results[name, m, s] for s in seeds] for m in methods}
        last = {m: [r[0][-1] for r in found[m]] for m in methods}
        rows = {}
        print(f"\n{name}: budget {FUNCTIONS[name].budget:g} whole trials, {len(seeds)} seeds")
        for m in methods:
            mean, half = interval(last[m])
            rows[m] = {
                "regret": mean,
                "by_seed": last[m],
                "interval": half,
                "median": statistics.median(last[m]),
                "log10": interval([math.log10(max(r, 1e-6)) for r in last[m]]),
                "curve": [interval([r[0][i] for r in found[m]]) for i in range(len(SHARES))],
                "trials": statistics.fmean(r[1] for r in found[m]),
                "whole": statistics.fmean(r[2] for r in found[m]),
                "seconds": statistics.fmean(r[3] for r in found[m]),
            }
            if "cmfbo" in methods and m != "cmfbo":  # paired by seed: above 0, cmfbo is better
                pairs = zip(last[m], last["cmfbo"], strict=True)
                rows[m]["less_cmfbo"] = interval([a - b for a, b in pairs])
            if m == "botorch_ucb" and "gp_ucb" in methods:
                pairs = zip(last[m], last["gp_ucb"], strict=True)
                rows[m]["less_gp_ucb"] = interval([a - b for a, b in pairs])
            curve = " ".join(f"{c[0]:8.4f}" for c in rows[m]["curve"])
            ahead = "{:8.4f} ± {:.4f}".format(*rows[m].get("less_cmfbo", (math.nan, math.nan)))
            print(
                f"  {m:14s} {mean:8.4f} ± {half:.4f}  median {rows[m]['median']:8.4f}"
                f"  log10 {rows[m]['log10'][0]:6.2f} ± {rows[m]['log10'][1]:.2f}  curve {curve}"
                f"  - cmfbo {ahead}  trials {rows[m]['trials']:.0f} ({rows[m]['whole']:.0f} whole)"
                f"  {rows[m]['seconds']:.1f} s"
            )
        if save:
            record = {
                "when": datetime.date.today().isoformat(),
                "function": name,
                "budget": FUNCTIONS[name].budget,
                "cheapest": cost(0.0),
                "after_initial": bool(os.environ.get("AFTER_INITIAL")),
                "seeds": list(seeds),
                "shares": SHARES,
                "searches": rows,
                "versions": _versions(),
            }
            append(RESULTS, record)


def time_asks(save: bool) -> None:
    """Seconds of the 61st ask of 12 parameters; of 60 trials every other one was a cheap one."""
    torch.set_num_threads(1)
    names = [f"x.x{i}" for i in range(12)]
    given = {"parameters": {name: {"low": 0.0, "high": 1.0} for name in names}, "trials": 99}
    seconds = {}
    for label, method in {"gp_ucb": GPUCB, "boca": BOCA, "cmfbo": CMFBO}.items():
        loop = method(make_options(method.Options, given, "search"), 0)
        for number in range(60):
            u = draws.spread(1, number, 12)
            z = 1.0 if method is GPUCB or number % 2 else 0.0
            y = math.exp(-sum((v - 0.6) ** 2 for v in u)) * (1 - 0.3 * z)
            y += 0.02 * math.sin(1e4 * sum(u))  # noise
            point = dict(zip(names, u, strict=True))
            loop.recall(Trial(f"trial{number}", point=point, fidelity=z))
            loop.tell(Report(f"trial{number}", "ok", y, cost=cost(z)))
        began, used = time.perf_counter(), time.process_time()
        loop.ask(60)
        seconds[label] = {
            "seconds": time.perf_counter() - began,
            "of_processor": time.process_time() - used,
        }
        print(f"{label:8s} " + "  ".join(f"{k} {v:.2f}" for k, v in seconds[label].items()))
    if save:
        with open(RESULTS, "a", encoding="utf-8") as file:
            row = {"when": datetime.date.today().isoformat(), "ask_60x12": seconds}
            file.write(json.dumps({**row, "versions": _versions()}) + "\n")


def _versions() -> dict[str, str]:
    return {
        "python": platform.python_version(),
        "torch": torch.__version__,
        "botorch": botorch.__version__,
        "gpytorch": gpytorch.__version__,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0, help="others than 0 choose constants")
    parser.add_argument("--cmfbo", default="{}", help="JSON of options of cmfbo to try, not saved")
    parser.add_argument(
        "--cheapest", type=float, default=0.1, help="cost of an easiest trial, in whole ones"
    )
    parser.add_argument(
        "--after-initial",
        action="store_true",
        help="budgets are equal after an initial design of 8 trials, of each search's own fidelity",
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--functions", nargs="*", default=list(FUNCTIONS), choices=FUNCTIONS)
    parser.add_argument("--searches", nargs="*", default=list(SEARCHES), choices=SEARCHES)
    parser.add_argument("--ask", action="store_true", help="time an ask instead")
    parser.add_argument("--no-save", action="store_true", help="print only")
    given = parser.parse_args()
    if given.ask:
        time_asks(not given.no_save)
    else:
        os.environ["CMFBO_OPTIONS"] = given.cmfbo
        os.environ["CHEAPEST"] = str(given.cheapest)
        os.environ["AFTER_INITIAL"] = "1" if given.after_initial else ""
        seeds = range(given.first_seed, given.first_seed + given.seeds)
        save = not given.no_save and given.cmfbo == "{}"
        compare(given.functions, given.searches, seeds, given.jobs, save)
