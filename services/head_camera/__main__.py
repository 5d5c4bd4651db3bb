"""``python -m valor.head_camera``."""

import sys

from valor.head_camera.service import HeadCamera
from valor.service import run

sys.exit(run("head_camera", HeadCamera))
