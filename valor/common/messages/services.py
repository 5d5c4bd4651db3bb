"""Messages of the Valor ROS Controller and the recorder, and statistics of all services."""

from enum import IntFlag

from bifrost import Message


class ModeStatus(IntFlag):
    """Flags of ``vigir_humanoid_control_msgs/ControlModeStatus``."""

    NO_ERROR = 0
    MODE_ACCEPTED = 1
    MODE_REJECTED = 2
    MODE_PREEMPTED = 4
    MODE_PROCESSING = 8
    MODE_DUPLICATE = 16
    EXTERNAL_CHANGE = 32
    ERR_UNKNOWN = 256
    ERR_CONTROLLER_NOT_READY = 512
    ERR_INVALID_BEHAVIOR_MODE = 1024
    ERR_INVALID_TRANSITION = 2048
    ERR_PRIOR_COMMAND_IN_PROGRESS = 4096


class ControlModeReport(Message):
    """The VRC's control mode and its cause (the Bifrost counterpart of /flor/controller/mode)."""

    time: int
    requested_control_mode: str
    current_control_mode: str
    status: int  # ModeStatus: flags of vigir_humanoid_control_msgs/ControlModeStatus
    behavior: str  # last reported by the Motion System; empty: none yet


class SnapRequest(Message):
    """Request to save the last seconds that the recorder holds."""


class SnapReply(Message):
    """The bag with them, or the reason of a rejection."""

    accepted: bool
    path: str
    messages: int
    seconds: float  # from receipt of the first message to the last [s]
    reason: str


class Statistics(Message):
    """Self-reported status of a service, once a second and at every change of state."""

    service: str
    pid: int
    state: str  # starting, ready, degraded, stopping
    detail: str  # what it waits for while starting; reason while degraded
    cycles: int  # of its main loop since start
    cycle_time_mean: float  # working time per cycle, over the last second [s]
    cycle_time_max: float
    period_mean: float  # between cycles, over the last second [s]
    period_max: float
    overruns: int  # cycles that took longer than the control period, since start
    cpu_percent: float  # of one core, over the last second
    memory_mib: float
    drops: int  # messages dropped by its queues since start
    rejected: int  # inputs rejected since start


class MarkRequest(Message):
    """Request for a mark at this moment of the recording."""

    text: str  # human-readable, one line


class MarkReply(Message):
    """Confirmation of the mark, or the reason of a rejection."""

    accepted: bool
    stamp: int  # of the recorder's wall clock [ns]
    reason: str
