"""``python -m valor.footstep_converter``."""

import sys

from valor.common.service import run
from valor.footstep_converter.service import FootstepConverter

sys.exit(run("footstep_converter", FootstepConverter))
