"""What the other services say: the Valor ROS Controller, the recorder, and every one of itself."""

from __future__ import annotations

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
    """The VRC's control mode and how it came to it (the Bifrost twin of /flor/controller/mode)."""

    time: int
    requested_control_mode: str
    current_control_mode: str
    status: int  # ModeStatus: flags of vigir_humanoid_control_msgs/ControlModeStatus
    behavior: str  # of the Motion System, as last reported; empty: not heard


class SnapRequest(Message):
    """Save the last seconds, of a recorder that holds them."""


class SnapReply(Message):
    """The bag in which they are, or why not."""

    accepted: bool
    path: str
    messages: int
    seconds: float  # from the first message's coming to the last's [s]
    reason: str


class Statistics(Message):
    """How a service fares: its own word, once a second and at every change of state."""

    service: str
    pid: int
    state: str  # starting, ready, degraded, stopping
    detail: str  # what it waits for while starting; what it cannot do while degraded
    cycles: int  # of its main loop since start
    cycle_time_mean: float  # spent working a cycle, over the last second [s]
    cycle_time_max: float
    period_mean: float  # between cycles, over the last second [s]
    period_max: float
    overruns: int  # cycles that took longer than the control period, since start
    cpu_percent: float  # of one core, over the last second
    memory_mib: float
    drops: int  # messages its queues dropped, since start
    rejected: int  # inputs it refused, since start


class MarkRequest(Message):
    """Note something at this moment of the recording."""

    text: str  # for people; a line


class MarkReply(Message):
    """Whether it stands there, or why not."""

    accepted: bool
    stamp: int  # of the recorder's wall clock [ns]
    reason: str


class BeyondRequest(Message):
    """Have the robot's side of the link do a verb of valorctl; or ask how one fares."""

    words: list[str]  # the verb and its arguments; none: how does ``number`` fare
    number: int


class BeyondReply(Message):
    """How a verb fares on the robot's side of the link."""

    number: int  # by which it is asked for
    state: str  # on its way, begun, ended, lost
    status: int  # its exit status, once it has ended
    said: str  # by it; or why nobody knows what becomes of it
    silent: float  # how long nothing of the robot's end has come [s]
