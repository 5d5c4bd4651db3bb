"""Start the Motion Manager: ``python -m valor.motion_manager``."""

import sys

from valor.common.service import run
from valor.motion_manager.service import MotionManagerService

sys.exit(run("motion_manager", MotionManagerService))
