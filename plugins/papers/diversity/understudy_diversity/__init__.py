"""Diversity searches: Bayesian, random, MAP-Elites, novel policies; and a gallery of what they found."""

#: Plugins that this one builds on.
REQUIRES = ("networks", "tensors", "terms", "bayes", "ppo", "report", "sweeps")

#: By kind and name: where each part is, and what it is in a sentence.
PARTS = {
    "outer_loop": {
        "diversity/bayesian": ("search:DiversitySearch", "Bayesian diversity search"),
        "diversity/random": ("search:RandomDiversity", "strategies at points drawn uniformly"),
        "diversity/map_elites": ("map_elites:MapElites", "MAP-Elites, through pyribs"),
        "diversity/novel_policies": ("novel_policies:NovelPolicies", "novelty, from a search"),
    },
    "reward": {
        "diversity/novelty": ("novelty:Novelty", "unlike the strategies known"),
        "diversity/passing": ("vault:passing", "passed the bar, the higher the better"),
    },
    "command": {
        "diversity count": ("count:Count", "how many different strategies searches found"),
    },
    "sweep_page": {
        "diversity/gallery": ("gallery:Gallery", "the strategies of a search"),
    },
    "scene": {
        "diversity/vault": ("vault:VaultScene", "a jumper and a bar, in the plane"),
    },
    "simulator": {
        "diversity/vault": ("vault:Vault", "a body that tucks and turns in flight"),
    },
    "initial_states": {
        "diversity/take_off": ("vault:TakeOff", "spin, climb and lean"),
    },
    "fields": {
        "diversity/bar": ("vault:Bar", "how high above the bar the body is"),
    },
    "encoder": {
        "diversity/body_state": ("vault:BodyState", "the body in flight"),
    },
    "actuation": {
        "diversity/limbs": ("vault:Limbs", "how tucked to be, how hard to turn"),
    },
    "termination": {
        "diversity/knocked": ("vault:knocked", "passed the bar too low"),
        "diversity/landed": ("vault:landed", "on the mat behind the bar"),
    },
}

#: Tasks, ``conf/task/NAME.yaml``, and what is learned in each.
TASKS = {
    "diversity/vault": "a body passes over a bar in one way or another",
}

#: How to cite what is implemented here.
CITATIONS = {
    "diversity": (
        "Yin, Yang, van de Panne, Yin 2021. Discovering diverse athletic jumping strategies. "
        "ACM Transactions on Graphics 40(4) (SIGGRAPH)."
    ),
    "map_elites": (
        "Mouret, Clune 2015. Illuminating search spaces by mapping elites. arXiv:1504.04909. "
        "Through pyribs: Tjanaka et al. 2023, GECCO."
    ),
}
