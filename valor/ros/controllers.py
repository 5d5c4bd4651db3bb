"""Topics of the balancing robot's controllers."""

COMMAND = "flor/controller/controller_command"
"""Name of the controller to use, ``std_msgs/String``."""
STATUS = "flor/controller/controllers"
"""``valor_msgs/ControllerStatus``, latched."""
