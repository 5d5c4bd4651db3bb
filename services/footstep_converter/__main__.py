"""``python -m footstep_converter``."""

import sys

from footstep_converter.service import FootstepConverter
from valor_common.service import run

sys.exit(run("footstep_converter", FootstepConverter))
