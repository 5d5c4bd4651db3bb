"""``python -m valor.hdt_bridge``."""

import sys

from valor.hdt_bridge.service import HdtBridge
from valor.service import run

sys.exit(run("hdt_bridge", HdtBridge))
