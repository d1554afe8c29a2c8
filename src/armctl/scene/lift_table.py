"""Heights and sizes of `armctl/ArmLift-v0`: geometry that truth and belief share. SI units."""

from armctl.scene.tabletop import TOP

GRASP_HEIGHT = TOP + 0.03
"""m: height of the end-effector, which is between the fingers' pads, while they close on the box."""
APPROACH_HEIGHT = TOP + 0.12
"""m: height at which the open hand passes over the box."""
OPENING = 0.08
"""m between the pads of the open hand."""
GRIPPED = 0.062
"""m: a hand with a smaller opening grips a box of the usual size, or has nothing."""
LARGEST = 0.07
"""m: the largest edge of a box, 1 cm less than the hand opens."""
LIFT_LOWEST, LIFT_HIGHEST = 0.1, 0.3
"""m above the table: heights to which the box's centre is to be lifted."""
