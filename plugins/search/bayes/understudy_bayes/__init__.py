"""Bayesian optimisation as outer loops: random search, GP-UCB, BOCA."""

#: Plugins that this one builds on.
REQUIRES = ("sweeps",)

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "outer_loop": {
        "random_search": ("random_search:RandomSearch", "points drawn uniformly"),
        "gp_ucb": ("gp_ucb:GPUCB", "Bayesian optimisation of whole trials"),
        "boca": ("boca:BOCA", "Bayesian optimisation with cheap approximations"),
        "side_by_side": ("side_by_side:SideBySide", "GP-UCB, several points in one training"),
    },
}

#: How to cite what is implemented here.
CITATIONS = {
    "gp_ucb": (
        "Srinivas, Krause, Kakade, Seeger 2010. Gaussian process optimization in the bandit setting: "
        "no regret and experimental design. ICML."
    ),
    "boca": (
        "Kandasamy, Dasarathy, Schneider, Póczos 2017. Multi-fidelity Bayesian optimisation with "
        "continuous approximations. ICML."
    ),
}
