"""Whether what is tuned suits the robot's size: margins that a sole has room for."""

from __future__ import annotations

from collections.abc import Iterator

from valor.common.table import TableError
from valor.robot.description import RobotDescription
from valor.whole_body.tuning_tables import Tuning


def margins_fit_the_soles(robot: RobotDescription) -> Iterator[TableError]:
    """Distances to keep inside a sole's edge are less than its half width: beyond, there is no place that keeps them.

    Raises:
        ConfigurationError: a section cannot be read.
    """
    tuning, feet = robot.read(Tuning), robot.tables.feet
    most = min(feet.left.half_width, feet.right.half_width)
    for key, margin in (
        ("disturbance.edge_margin", tuning.disturbance.edge_margin),
        ("pelvis.com_margin", robot.tables.pelvis.com_margin),
        ("whole_body.contact_inset", tuning.whole_body.contact_inset),
    ):
        if margin >= most:
            yield TableError(key.split("."), f"got {margin:g}; expected less than a sole's half width, {most:g}")
