"""The tasks of the Whole-Body Controller. A new one is a file and its line here: rows and weights follow."""

from __future__ import annotations

from valor.robot.model import Model
from valor.whole_body.model.motion import Motions
from valor.whole_body.tasks.angular_momentum import AngularMomentum
from valor.whole_body.tasks.centre_of_mass import CentreOfMass
from valor.whole_body.tasks.feet import FootMotion
from valor.whole_body.tasks.orientation import ChestOrientation, PelvisOrientation
from valor.whole_body.tasks.posture import GROUPS
from valor.whole_body.tasks.task import Task
from valor.whole_body.tuning_tables import WholeBody

TASKS: tuple[type[Task], ...] = (
    CentreOfMass,
    AngularMomentum,
    ChestOrientation,
    PelvisOrientation,
    FootMotion,
)

WEIGHTS: tuple[str, ...] = (*dict.fromkeys(task.weight for task in TASKS), *GROUPS)
"""Names of the weights: of the tasks, then of the posture's groups."""


def motions(model: Model) -> Motions:
    """What the tasks want something of: which rows are whose."""
    return Motions({task.name: task.motion(model) for task in TASKS})


def nominal_weights(table: WholeBody) -> list[float]:
    """In the order of ``WEIGHTS``: ``<name>_weight`` of the table, or the task's default."""
    defaults = {task.weight: task.default_weight for task in TASKS}
    return [float(getattr(table, f"{name}_weight", defaults.get(name, 0.0))) for name in WEIGHTS]
