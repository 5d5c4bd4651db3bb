"""``python -m valor.operator_station``."""

import sys

from valor.operator_station.service import OperatorStation
from valor.service import run

sys.exit(run("operator_station", OperatorStation))
