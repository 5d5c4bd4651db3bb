"""``python -m valor.comms_manager``."""

import sys

from valor.comms_manager.service import CommsManager
from valor.service import run

sys.exit(run("comms_manager", CommsManager))
