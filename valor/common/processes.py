"""Every process of an instance: how it starts, what it needs, what it may use.

One of the two tables a newcomer opens first (the other is ``topics.py``). The supervisor's configuration, the health
checks of ``valorctl`` and the tables in the documentation come from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

DAEMON = "bifrostd"
RECORDER = "bag_recorder"
EXIT_CONFIGURATION = 78  # sysexits' EX_CONFIG: the supervisor does not start the process again

Cores = Literal["own", "others", "any"]
Turns = Literal["short", "usual", "background"]


@dataclass(frozen=True)
class Process:
    """One line of the table."""

    name: str
    module: str  # started as ``python -m module``
    description: str
    needs: tuple[str, ...]  # started after these
    straddles_ros: bool  # imports rclpy
    cpu_budget: float  # [% of one core], standing, at 500 Hz
    memory_budget: float  # [MiB]
    stop_timeout: float = 5.0  # from SIGTERM to SIGKILL [s]
    after: tuple[str, ...] = ()  # started after these, too, where the profile has them
    device: str = ""  # only for robots that have a device of this kind
    hardware_only: bool = False  # no part of a simulation
    priority: int = 0  # nice value that it takes on hardware, where the system grants it
    real_time: int = 0  # priority of its loop (SCHED_FIFO; with hardware alone, but for the Motion Manager's); 0: none
    spokesmen: tuple[str, ...] = ()  # who may publish its Statistics, too
    cores: Cores = "others"  # in a simulation in real time: the last core as its own, the others, or any of them
    turns: Turns = "usual"  # on a core, where robot time is kept to the wall's (priority.py)


# fmt: off
PROCESSES: tuple[Process, ...] = (
    #       name                    module                  description                              needs          ROS    CPU [%] memory [MiB]
    Process("bifrostd",             "bifrost.daemon",       "who publishes what",                    (),            False,  5.0,   60.0),
    Process("device_emulators",     "valor.device_emulators", "the devices' far ends, without a robot", ("bifrostd",), False, 80.0, 150.0, hardware_only=True, priority=-10, real_time=20),
    Process("hdt_driver",           "valor.hdt_driver",     "the vendor's driver of the HDT arms",   ("bifrostd",), True,  25.0,  110.0, after=("device_emulators",), device="hdt_bifrost", hardware_only=True, priority=-5, spokesmen=("hdt_bridge",)),
    Process("hdt_bridge",           "valor.hdt_bridge",     "Bifrost to the HDT driver's ROS",       ("bifrostd",), True,  25.0,  110.0, device="hdt_bifrost", hardware_only=True, priority=-5),
    Process("comms_manager",        "valor.comms_manager",  "the robot's hardware in one place",     ("bifrostd",), False, 45.0,  150.0, after=("device_emulators", "hdt_driver", "hdt_bridge"), priority=-10, real_time=20, cores="any", turns="short"),
    Process("motion_manager",       "valor.motion_manager", "state machines and whole-body control", ("bifrostd",), False, 70.0,  150.0, priority=-10, real_time=20, cores="own", turns="short"),
    Process("valor_ros_controller", "valor.valor_ros_controller", "robot controller; ROS 2 to Bifrost",    ("bifrostd",), True,  50.0,  160.0, priority=-5),
    Process("footstep_converter",   "valor.footstep_converter", "footstep plans to the Motion System",   ("bifrostd",), True,  10.0,  130.0),
    Process("bag_recorder",         "valor.bag_recorder",   "Bifrost and ROS messages in one bag",   ("bifrostd",), True,  50.0,  200.0, 10.0, turns="background"),
)
# fmt: on

BY_NAME: dict[str, Process] = {process.name: process for process in PROCESSES}
