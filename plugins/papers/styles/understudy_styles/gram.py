"""How far the style of a motion is from that of a clip (thesis, eq. 3.6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context, Fields, Shape
from understudy_characters.scene import CharacterScene
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.section import Motion
from understudy_skills.kept import files_of
from understudy_styles.autoencoder import MotionAutoEncoder, trained_network
from understudy_styles.features import clip_features


class GramDistance(Fields):
    """``gram_distance`` (N,) = ‖G_s - G‖ / ‖G_s - G_r‖: G is the Gram matrix of the features of the last
    frames, G_s that of the style's clip, G_r that of the clip that the task refers to.

    So 1 means as far from the style as the reference is, and 0 means in the style. ``feature_history`` (K, D) holds
    the frames, the newest first (the memory ``history`` of ``motion_features``); the paper's K is a cycle.
    """

    reads = ("feature_history",)
    provides: Mapping[str, Shape] = {"gram_distance": ()}

    @dataclass(frozen=True)
    class Options:
        run: str  #: the folder of a trained auto-encoder (experiment=styles/autoencoder)
        style: str  #: the clip whose style is meant, by name or file
        frames: int = 24  #: K, how many frames the clips' windows have; as many as the history has

        def __post_init__(self) -> None:
            check_range(self, "frames", least=2, most=10_000)

    def __init__(self, options: Options, context: Context) -> None:
        who = "fields 'styles/gram'"
        scene = context.need_scene(CharacterScene, who)
        motion = context.need_section("motion", Motion, who)
        assert context.registry is not None
        kept = context.inputs.file(f"features {options.run}", lambda: files_of(options.run)).parent
        network = trained_network(str(kept), scene, context.registry)

        def gram_of(clip: Clip, name: str = "") -> Tensor:
            frames = clip_features(clip, scene, context.control_dt, options.frames, name)
            return mean_gram(network, frames, options.frames)

        style = gram_of(
            library.kept(options.style, context.registry, context.inputs), options.style
        )
        unit = (style - gram_of(motion.clip)).norm()
        if float(unit) < 1e-6:
            raise ConfigError(
                f"fields 'styles/gram': {options.style} has the style of the reference itself; name "
                "another clip (fields.gram.style=CLIP)."
            )
        self._frames = options.frames
        self._network = network.to(context.device)
        self._style, self._unit = style.to(context.device), unit.to(context.device)

    def compute(self, feature_history: Tensor) -> Mapping[str, Tensor]:
        if (kept := feature_history.shape[1]) != self._frames:  # else 1 would not be the reference
            raise ConfigError(
                f"fields.gram.frames={self._frames} is not possible: feature_history has {kept} frames "
                "(memory.feature_history.length). Give both the same."
            )
        gram = self._network.gram(feature_history.flip(1))
        return {"gram_distance": (gram - self._style).norm(dim=(1, 2)) / self._unit}


@torch.no_grad()
def mean_gram(network: MotionAutoEncoder, frames: Tensor, window: int) -> Tensor:
    """(C, C) over all windows of `frames` (F, D)."""
    return network.gram(frames.unfold(0, window, 1).mT).mean(0)
