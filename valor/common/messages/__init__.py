"""The types of the Bifrost topics (units in brackets, frames in names).

Vectors over joints have one entry a joint, in the order of ``RobotDescription.joints``. Quaternions are (w, x, y, z).
``time`` is robot time [ns]: the stamp of the Proprioceptor that a message belongs to, simulated time in simulation.
Wrenches are (fx, fy, fz, tx, ty, tz) [N, N·m]: what the world does to the robot, at the named frame's origin and in
its axes.
"""

from valor.common.messages.hardware import *
from valor.common.messages.motion import *
from valor.common.messages.services import *
from valor.common.messages.simulation import *
