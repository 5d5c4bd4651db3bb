"""``python -m valor.lidar``."""

import sys

from valor.lidar.service import LidarService
from valor.service import run

sys.exit(run("lidar", LidarService))
