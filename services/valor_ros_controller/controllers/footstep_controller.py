"""Robot-level footstep controller: how far a footstep plan is.

The Motion System takes the steps and the Footstep Converter hands it the plans; what is here is the controller's
state, by ViGIR's names, for whoever watches.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Protocol

from valor.common.messages import StepStatus
from valor.valor_ros_controller.controller_manager import Onlooker


class State(IntEnum):
    """As ``vigir_footstep_planning_msgs/ExecuteStepPlan`` numbers ``controller_state``."""

    NOT_READY = 0
    READY = 1
    ACTIVE = 2
    PAUSED = 3
    FINISHED = 4
    FAILED = 5


_STATES = {"idle": State.READY, "executing": State.ACTIVE, "finished": State.FINISHED, "failed": State.FAILED}


class StepSource(Protocol):
    """Where the Motion System's word comes from."""

    step_status: StepStatus | None  # the newest; None: not heard, or silent


class FootstepController(Onlooker):
    """What the Motion System says of its steps."""

    name = "footstep_controller"
    type = "valor_ros_controller/FootstepController"

    def __init__(self, source: StepSource) -> None:
        self._source = source

    @property
    def status(self) -> StepStatus | None:
        """The Motion System's newest word; None while inactive."""
        return self._source.step_status if self.active else None

    @property
    def state(self) -> State:
        """NOT_READY while inactive or before the Motion System has spoken."""
        status = self.status
        return _STATES.get(status.state, State.NOT_READY) if status else State.NOT_READY
