"""Start the Motion Manager: ``python -m valor.motion_manager``."""

import sys

from valor.motion_manager.service import MotionManagerService
from valor.service import run

sys.exit(run("motion_manager", MotionManagerService))
