"""Start the service."""

import sys

from valor.service import run
from valor.valor_ros_controller.service import ValorRosController

sys.exit(run("valor_ros_controller", ValorRosController))
