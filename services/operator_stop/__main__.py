"""``python -m valor.operator_stop``."""

import sys

from valor.operator_stop.service import OperatorStop
from valor.service import run

sys.exit(run("operator_stop", OperatorStop))
