"""What a task is: a motion of the robot, the acceleration that is wanted of it, and a weight."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

from valor.common.arrays import FloatArray
from valor.common.kernel import Expression
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.whole_body.balance.dcm import DcmLaw
from valor.whole_body.balance.reference import Feet, Reference
from valor.whole_body.model.motion import Motion


class Period(NamedTuple):
    """What tasks know of a control period, as expressions; in odom."""

    reference: Reference
    law: DcmLaw
    com: Expression  # (3,) [m]
    repellent_point: Expression  # (3,) that the DCM law asks for [m]
    feet: Feet
    stance: Expression  # (3,) that is kept while the robot stands, as of ``feet.stance``
    steps: Expression  # whether the robot steps
    swinging: Expression  # (2,) whether the left, the right foot is in the air
    swing: Expression  # (24,) where it shall be then: ``SwingPoint``, one field after another


class Task(ABC):
    """Wants J·v̇ + drift of its motion to be an acceleration: ½·w·‖J·v̇ + drift − a‖² is its part of the objective.

    Attributes:
        name: of its rows.
        weight: w is ``<weight>_weight`` of the ``whole_body`` table of robot.yaml, and can be changed by this name.
        default_weight: w where that table has none.
    """

    name: ClassVar[str]
    weight: ClassVar[str]
    default_weight: ClassVar[float] = 0.0

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot

    @staticmethod
    @abstractmethod
    def motion(model: Model) -> Motion:
        """What it wants something of."""

    @abstractmethod
    def acceleration(self, period: Period, velocity: Expression, pose: Expression) -> Expression:
        """(rows,) a.

        Args:
            period: what is known of it.
            velocity: (rows,) of the motion, in odom.
            pose: (size,) of the motion.
        """

    def weigh(self, weight: float, swinging: int | None, out: FloatArray) -> None:
        """Write the weights of its rows into (rows,) ``out``; ``swinging`` is the foot in the air, or None."""
        out[:] = weight
