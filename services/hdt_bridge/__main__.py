"""``python -m valor.hdt_bridge``."""

import sys

from valor.common.service import run
from valor.hdt_bridge.service import HdtBridge

sys.exit(run("hdt_bridge", HdtBridge))
