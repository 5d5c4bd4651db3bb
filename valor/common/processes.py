"""Every process of an instance: how it starts, what it needs, what it may use.

One of the two tables a newcomer opens first (the other is ``topics.py``). Add a line here and a folder of the same name
to add a process: the supervisor's configuration, the keys, the Statistics topics, the health checks of ``valorctl`` and
the tables in the documentation come from it, and a test holds a running system against its budgets.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

DAEMON = "bifrostd"
RECORDER = "bag_recorder"
FOXGLOVE = "foxglove_bridge"
HEAD_CAMERA = "head_camera"
OPERATOR_STOP = "operator_stop"
VIEW = "--view"
LINK = "--link"
CAMERA = "--camera"
SUPERVISED = "VALOR_SUPERVISED"  # in the environment of supervisord, and so of all that it starts
EXIT_CONFIGURATION = 78  # sysexits' EX_CONFIG: the supervisor does not start the process again

Cores = Literal["own", "others", "any"]
Turns = Literal["short", "usual", "background"]


@dataclass(frozen=True)
class Process:
    """One line of the table. All but the daemon need it, and start when it answers."""

    name: str
    description: str
    cpu_budget: float  # [% of one core], standing, at 500 Hz, of a robot that runs in real time
    memory_budget: float  # [MiB]
    after: tuple[str, ...] = ()  # started after these, where the profile has them
    stop_timeout: float = 5.0  # from SIGTERM to SIGKILL [s]
    device: str = ""  # only for robots that have a device of this kind
    hardware_only: bool = False  # no part of a simulation
    priority: int = 0  # nice value that it takes on hardware, where the system grants it
    real_time: int = 0  # priority of its loop (SCHED_FIFO; with hardware alone, but for the Motion Manager's); 0: none
    cores: Cores = "others"  # in a simulation in real time: the last core as its own, the others, or any of them
    turns: Turns = "usual"  # on a core, where robot time is kept to the wall's (priority.py)
    spokesmen: tuple[str, ...] = ()  # who may publish its Statistics, too
    option: str = ""  # of `up`, which asks for it; empty: there where no profile names others

    @property
    def module(self) -> str:
        """Started as ``python -m module``."""
        return "bifrost.daemon" if self.name == DAEMON else f"valor.{self.name}"

    @property
    def needs(self) -> tuple[str, ...]:
        """Started when these are ready."""
        return () if self.name == DAEMON else (DAEMON,)


# fmt: off
PROCESSES: tuple[Process, ...] = (
    #       name                    description                              CPU [%] memory [MiB]
    Process(DAEMON,                 "who publishes what",                     5.0,    60.0),
    Process("device_emulators",     "the devices' far ends, without a robot", 80.0,  150.0, hardware_only=True, priority=-10, real_time=20),
    Process("hdt_driver",           "the vendor's driver of the HDT arms",    25.0,  110.0, ("device_emulators",), device="hdt_bifrost", hardware_only=True, priority=-5, spokesmen=("hdt_bridge",)),
    Process("hdt_bridge",           "Bifrost to the HDT driver's ROS",        25.0,  110.0, device="hdt_bifrost", hardware_only=True, priority=-5),
    Process("comms_manager",        "the robot's hardware in one place",      45.0,  150.0, ("device_emulators", "hdt_driver", "hdt_bridge"), priority=-10, real_time=20, cores="any", turns="short"),
    Process("motion_manager",       "state machines and whole-body control",  70.0,  150.0, priority=-10, real_time=20, cores="own", turns="short"),
    Process("valor_ros_controller", "robot controller; ROS 2 to Bifrost",     50.0,  160.0, priority=-5),
    Process("footstep_converter",   "footstep plans to the Motion System",    10.0,  130.0),
    Process(RECORDER,               "Bifrost and ROS messages in one bag",    50.0,  200.0, stop_timeout=10.0, turns="background"),
    Process(OPERATOR_STOP,          "the stop button of the operator's page", 5.0,    90.0, priority=-5, option=VIEW),
    Process("operator_station",     "the page to see and drive the robot",    20.0,  300.0, turns="background", option=VIEW),
    Process("link_robot",           "robot's end of the link to the operator", 25.0, 130.0, option=LINK),
    Process("link_operator",        "operator's end of it, in his ROS domain", 25.0, 130.0, option=LINK),
    Process(HEAD_CAMERA,            "the simulated robot's camera, for ROS 2", 40.0, 250.0, turns="background", option=CAMERA),
    Process(FOXGLOVE,               "ROS topics and a scene, for Foxglove",   20.0,  150.0, turns="background", option="--foxglove"),
)
# fmt: on

BY_NAME: dict[str, Process] = {process.name: process for process in PROCESSES}
