"""Controllers of a robot beside the Whole-Body Controller, from the names in ``controllers`` of robot.yaml."""

from valor.common.errors import SeveralFaultsError
from valor.control.controller import ControllerFactory
from valor.motion_manager.locomotion.remote import RemoteController
from valor.policies.factories import controller_factory
from valor.robot.checks.controllers import controllers_exist, others
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import REMOTE


def controller_factories(robot: RobotDescription) -> list[ControllerFactory]:
    """Return one factory for each name. Raises ConfigurationError: there is no such controller or policy."""
    SeveralFaultsError.require_none(robot.error(each.path, each.what) for each in controllers_exist(robot))
    return [RemoteController if name == REMOTE else controller_factory(robot, name) for name in others(robot)]
