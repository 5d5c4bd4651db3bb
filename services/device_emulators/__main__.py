"""``python -m valor.device_emulators``."""

import sys

from valor.common.service import run
from valor.device_emulators.service import DeviceEmulators

sys.exit(run("device_emulators", DeviceEmulators))
