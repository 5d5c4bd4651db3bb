"""``python -m hdt_bridge``."""

import sys

from hdt_bridge.service import HdtBridge
from valor_common.service import run

sys.exit(run("hdt_bridge", HdtBridge))
