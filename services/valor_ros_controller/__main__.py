"""Start the service."""

import sys

from valor_common.service import run
from valor_ros_controller.service import ValorRosController

sys.exit(run("valor_ros_controller", ValorRosController))
