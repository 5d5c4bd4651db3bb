"""``python -m valor.comms_manager``."""

import sys

from valor.common.service import run
from valor.comms_manager.service import CommsManager

sys.exit(run("comms_manager", CommsManager))
