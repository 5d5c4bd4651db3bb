"""The processes of an instance: start order, requirements, budgets.

To add a process, add a line here and a folder of the same name. Supervision, keys, Statistics topics, health checks and
the tables in the documentation follow from this table.
"""

from dataclasses import dataclass
from typing import Literal

DAEMON = "bifrostd"
RECORDER = "bag_recorder"
FOXGLOVE = "foxglove_bridge"
HEAD_CAMERA = "head_camera"
LIDAR = "lidar"
VIEW = "--view"
LINK = "--link"
SUPERVISED = "VALOR_SUPERVISED"  # environment variable of supervisord and all that it starts
EXIT_CONFIGURATION = 78  # sysexits' EX_CONFIG: the supervisor does not restart the process

Cores = Literal["own", "others", "any"]
Turns = Literal["short", "usual", "background"]


@dataclass(frozen=True)
class Process:
    """One line of the table. All processes but the daemon start when the daemon responds."""

    name: str
    description: str
    cpu_budget: float  # [% of one core], while standing, at 500 Hz in real time
    memory_budget: float  # [MiB]
    after: tuple[str, ...] = ()  # started after these, if the profile contains them
    stop_timeout: float = 5.0  # from SIGTERM to SIGKILL [s]
    device: str = ""  # only for robots with a device of this kind
    hardware_only: bool = False  # not part of a simulation
    priority: int = 0  # nice value on hardware, if the system grants it
    real_time: int = 0  # priority of its loop (SCHED_FIFO; on hardware only, except the Motion Manager's); 0: none
    cores: Cores = "others"  # in a simulation in real time: the last core, the others, or any
    turns: Turns = "usual"  # time slice, if robot time is proportional to wall time (priority.py)
    spokesmen: tuple[str, ...] = ()  # other publishers of its Statistics
    option: str = ""  # of `up` that requests it; empty: default process

    @property
    def module(self) -> str:
        """Module to start with ``python -m``."""
        return "bifrost.daemon" if self.name == DAEMON else f"valor.{self.name}"

    @property
    def needs(self) -> tuple[str, ...]:
        """Processes that must be ready before it starts."""
        return () if self.name == DAEMON else (DAEMON,)


# fmt: off
PROCESSES: tuple[Process, ...] = (
    #       name                    description                              CPU [%] memory [MiB]
    Process(DAEMON,                 "name service of Bifrost",                 5.0,    60.0),
    Process("device_emulators",     "emulated devices, without a robot",      80.0,  150.0, hardware_only=True, priority=-10, real_time=20),
    Process("hdt_driver",           "the vendor's driver of the HDT arms",    25.0,  110.0, ("device_emulators",), device="hdt_bifrost", hardware_only=True, priority=-5, spokesmen=("hdt_bridge",)),
    Process("hdt_bridge",           "Bifrost to the HDT driver's ROS",        25.0,  110.0, device="hdt_bifrost", hardware_only=True, priority=-5),
    Process("comms_manager",        "access to the robot's hardware",         45.0,  150.0, ("device_emulators", "hdt_driver", "hdt_bridge"), priority=-10, real_time=20, cores="any", turns="short"),
    Process("motion_manager",       "state machines and whole-body control",  70.0,  150.0, priority=-10, real_time=20, cores="own", turns="short"),
    Process("valor_ros_controller", "robot controller; ROS 2 to Bifrost",     50.0,  160.0, priority=-5),
    Process("footstep_converter",   "footstep plans to the Motion System",    10.0,  130.0),
    Process(RECORDER,               "Bifrost and ROS messages in one bag",    50.0,  200.0, stop_timeout=10.0, turns="background"),
    Process("operator_stop",        "the operator's page, with its STOP",     5.0,    90.0, priority=-5, option=VIEW),
    Process("operator_station",     "the view in it, of the robot",           20.0,  300.0, turns="background", option=VIEW),
    Process("link_robot",           "robot's end of the link to the operator", 25.0, 130.0, option=LINK),
    Process("link_operator",        "operator's end of it, in his ROS domain", 25.0, 130.0, option=LINK),
    Process(HEAD_CAMERA,            "the simulated robot's stereo camera, for ROS 2", 60.0, 400.0, turns="background", option="--sensors camera"),
    Process(LIDAR,                  "the simulated robot's rolling lidar, for ROS 2", 20.0, 250.0, turns="background", option="--sensors lidar"),
    Process(FOXGLOVE,               "ROS topics and a scene, for Foxglove",   20.0,  150.0, turns="background", option="--foxglove"),
)
# fmt: on

BY_NAME: dict[str, Process] = {process.name: process for process in PROCESSES}


@dataclass(frozen=True)
class Sensor:
    """Sensor of the robot that only ROS 2 uses, simulated by a process."""

    process: str
    topic: str  # on ROS 2, on hardware of the maker's driver


SENSORS = {"lidar": Sensor(LIDAR, "lidar/scan"), "camera": Sensor(HEAD_CAMERA, "multisense/left/depth")}
"""By the name in robot.yaml and in ``up --sensors``."""
