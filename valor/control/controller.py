"""Interface of controllers.

The Motion Manager runs one controller at a time. It stays outside: watchdog, estimate, fall detection, behaviors and
the last check of each command are the same for all. Vectors have one entry for each of the n joints, in the order of
``RobotDescription.joints``.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray
from valor.common.behaviors import Locomotion
from valor.control.kinematics import Kinematics
from valor.control.state import RobotState
from valor.control.steps import StepSource
from valor.robot.description import RobotDescription
from valor.robot.limiter import Joints


@dataclass(slots=True)
class JointTargets:
    """Targets of arms, hands, waist and neck, by their clients or at rest; those of the legs are ignored."""

    position: FloatArray  # (n,) [rad]
    velocity: FloatArray  # (n,) [rad/s]
    acceleration: FloatArray  # (n,) [rad/s²]
    stiffness: FloatArray  # (n,) of the servos [N·m/rad]
    damping: FloatArray  # (n,) [N·m·s/rad]
    frozen: npt.NDArray[np.bool_] | None = None  # (n,) mask of joints that hold


@dataclass(slots=True)
class Request:
    """Request to a controller for a period."""

    joints: JointTargets
    locomotion: Locomotion = Locomotion.STAND
    # (3,) of a walk: forward, left [m/s], turning left [rad/s]
    velocity: FloatArray = field(default_factory=lambda: np.zeros(3))
    steps: StepSource | None = None  # to take, of a plan or of a walk; None: none


@dataclass(slots=True)
class JointCommand:
    """A servo applies effort + stiffness·(position − q) + damping·(velocity − q̇) [N·m]."""

    position: FloatArray  # (n,) [rad]
    velocity: FloatArray  # (n,) [rad/s]
    effort: FloatArray  # (n,) [N·m]
    stiffness: FloatArray  # (n,) [N·m/rad]
    damping: FloatArray  # (n,) [N·m·s/rad]


class Controller(ABC):
    """Controls the joints while the robot balances."""

    name: str  # in robot.yaml and for clients
    states: ClassVar[frozenset[Locomotion]]  # of the Locomotion FSM that it serves
    takes_footsteps: ClassVar[bool] = False  # those of a request
    steps_to_balance: ClassVar[bool] = False  # by itself, also while the robot stands
    period: int = 1  # between updates, in control periods
    warm_up: float = 0.0  # time for which it must see the robot before it is in control [s]
    joints: Joints  # (n,) mask of joints that it commands; the others follow their targets

    @property
    @abstractmethod
    def at_rest(self) -> bool:
        """True if both feet are to stay where they are."""

    def footholds(self, state: RobotState) -> tuple[FloatArray, FloatArray] | None:
        """(2, 3) positions [m] and (2, 3, 3) rotations of soles after the step under way; None if both stand."""
        return None

    def refusal(self, state: RobotState) -> str:
        """Reason why it cannot start from a state; empty if it can."""
        return ""

    def chosen(self) -> None:  # noqa: B027 (most do not depend on it)
        """A client has chosen it; precedes ``refusal`` and ``begin``."""

    @abstractmethod
    def begin(self, state: RobotState, last: JointCommand | None) -> None:
        """Start from a state; ``last`` is the command in force, None if servos held the joints."""

    @abstractmethod
    def update(self, state: RobotState, request: Request, dt: float) -> JointCommand | None:
        """Compute the command of a period, ``dt`` after the last one [s]; None keeps the last command."""

    def end(self) -> None:  # noqa: B027 (most have nothing to end)
        """Give up control."""


ControllerFactory = Callable[[RobotDescription, Kinematics], Controller]
"""Makes a controller of a robot; the kinematics are those of every state that it will receive."""
