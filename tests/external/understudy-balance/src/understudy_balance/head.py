"""How high the head is: a reward that needs the scene."""

from dataclasses import dataclass

from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context
from understudy.task.terms import ranges
from understudy_characters.heads import head_body
from understudy_characters.scene import CharacterScene


@ranges(0.0, 1.0)
class HeadHeight:
    """The height of the head's centre of mass as a share of `height`, from 0 to 1, (N,)."""

    @dataclass(frozen=True)
    class Options:
        height: float = 1.4  #: m above z = 0, above 0

        def __post_init__(self) -> None:
            check_range(self, "height", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "reward 'balance/head'")
        head = head_body(scene.character)
        if head is None:
            raise ConfigError("reward 'balance/head': this character has no head.")
        self._head, self._height = head, options.height

    def __call__(self, xipos: Tensor) -> Tensor:
        return (xipos[:, self._head, 2] / self._height).clamp(0.0, 1.0)
