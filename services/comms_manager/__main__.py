"""``python -m comms_manager``."""

import sys

from comms_manager.service import CommsManager
from valor_common.service import run

sys.exit(run("comms_manager", CommsManager))
