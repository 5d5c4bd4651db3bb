"""The types of the Bifrost topics (units in brackets, frames in names).

Vectors over joints are in the order of ``RobotDescription.joints``; quaternions are (w, x, y, z). ``time`` is robot
time [ns] of the Proprioceptor that a message belongs to. Wrenches (fx, fy, fz, tx, ty, tz) [N, N·m] act from the world
on the robot, at the named frame's origin and in its axes.
"""

from valor.common.messages.hardware import *
from valor.common.messages.motion import *
from valor.common.messages.services import *
from valor.common.messages.simulation import *
