"""``python -m valor.link_robot``."""

import sys

from valor.link_robot.service import LinkRobot
from valor.service import run

sys.exit(run("link_robot", LinkRobot))
