"""Start the Motion Manager: ``python -m motion_manager``."""

import sys

from motion_manager.service import MotionManagerService
from valor_common.service import run

sys.exit(run("motion_manager", MotionManagerService))
