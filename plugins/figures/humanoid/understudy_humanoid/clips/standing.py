"""Standing at ease: how clips begin and end that are not walked or run through.

The centre of mass is over the origin, between the feet, and the character faces x.
"""

from __future__ import annotations

import numpy as np

from understudy_humanoid.clips.figure import SIGN, Array, Side

HEIGHT = 0.876  #: m, of the root; the knees are a little bent
CENTRE = 0.8883  #: m, height of the centre of mass then
HALF_WIDTH = 0.085  #: m, of the ankles from the middle
TOE_OUT = np.radians(6.0)
PITCH = 2.0  #: degrees, of the trunk and the head, forward
AHEAD = 0.045  #: m, of the centre of mass from the ankles, over the middle of the feet
ARM = (2.0, 8.0, 18.0)  #: degrees: shoulder's flexion and abduction, elbow's flexion


def place(side: Side) -> Array:
    """Where a foot stands, (2,) m."""
    return np.array([-AHEAD, SIGN[side] * HALF_WIDTH])
