"""``python -m valor.footstep_converter``."""

import sys

from valor.footstep_converter.service import FootstepConverter
from valor.service import run

sys.exit(run("footstep_converter", FootstepConverter))
