"""Motions of our own, for the character of :mod:`understudy_humanoid.character`.

They are built, not recorded: what bears the body (feet, hands, a seat) is laid down first and does not
slide, the centre of mass goes where forces could take it, and inverse kinematics joins the two. One
module per family; :mod:`.figure`, :mod:`.limbs` and :mod:`.curves` are what they share.
"""

from understudy_humanoid.clips.backflip import generated_backflip
from understudy_humanoid.clips.cartwheel import generated_cartwheel
from understudy_humanoid.clips.hop import generated_hop
from understudy_humanoid.clips.run import generated_run
from understudy_humanoid.clips.sit import generated_sit, generated_stand
from understudy_humanoid.clips.turn import generated_turn_left, generated_turn_right
from understudy_humanoid.clips.walk import generated_walk

__all__ = [
    "generated_backflip",
    "generated_cartwheel",
    "generated_hop",
    "generated_run",
    "generated_sit",
    "generated_stand",
    "generated_turn_left",
    "generated_turn_right",
    "generated_walk",
]
