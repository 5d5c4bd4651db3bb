"""``python -m valor.foxglove_bridge``."""

import sys

from valor.foxglove_bridge.service import FoxgloveBridge
from valor.service import run

sys.exit(run("foxglove_bridge", FoxgloveBridge))
