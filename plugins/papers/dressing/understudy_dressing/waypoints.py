"""Where hands and arms go as a shirt is put on; the subtasks begin at some of these places (ours).

Places are for the left arm going in while the right hand holds the hem; the other way round they are mirrored. Poses are of the
left arm, from clavicle to wrist, or mirrored.
"""

from __future__ import annotations

#: m: where one hand holds the hem, and the places by which the other goes under it. They are in front of the body, so that no
#: elbow is driven into the shirt's back.
HELD_AT = (0.38, -0.02, -0.35)
TUCKED_AT = ((0.20, 0.05, -0.66), (0.26, 0.03, -0.50), (0.29, 0.03, -0.40))
#: m: where the fingertip goes on from there without tearing the cloth: beyond the triangle of holding hand and shoulders.
BEYOND_AT = ((0.31, 0.0, -0.27), (0.31, -0.01, -0.20))
#: m: then the holding hand lowers the hem, and the other goes back to the chest and to its own shoulder.
LOWERED_AT = (0.36, -0.02, -0.45)
BACK_AT = ((0.22, 0.05, -0.14), (0.14, 0.14, -0.02), (0.11, 0.24, -0.04))
#: m: where the hand goes, once it is under the hem, until it is in front of the chin.
RAISED_AT = (*BEYOND_AT, (0.30, 0.0, -0.02), (0.28, 0.0, 0.12))
#: rad: elbow bent in front of the chest, hand at its own shoulder; a fifth of the limb is in the sleeve drawn over it. Straighter
#: arms tear the cloth as it settles, and finer cloth may tear with these, too.
IN_SLEEVE = (
    (0.25, -0.12, 0.36, -0.87, 1.00, 2.61, -0.60, 0.60),
    (0.25, -0.25, 0.25, -0.77, 1.00, 2.72, -0.60, 0.60),
    (0.25, -0.24, 0.36, -0.91, 1.00, 2.73, -0.60, 0.60),
)
#: rad: the arm out to its side, in its sleeve.
DRESSED = (0.0, 0.0, -1.2, 0.0, 0.0, 0.25, 0.0, 0.0)
