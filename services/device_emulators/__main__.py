"""``python -m device_emulators``."""

import sys

from device_emulators.service import DeviceEmulators
from valor_common.service import run

sys.exit(run("device_emulators", DeviceEmulators))
