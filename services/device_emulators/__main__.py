"""``python -m valor.device_emulators``."""

import sys

from valor.device_emulators.service import DeviceEmulators
from valor.service import run

sys.exit(run("device_emulators", DeviceEmulators))
