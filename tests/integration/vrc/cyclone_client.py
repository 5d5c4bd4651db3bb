"""Client without ROS: CycloneDDS for Python, and the types that it needs as IDL defines them.

It reads joint states and robot time, and requests a control mode by topic. It prints its findings as JSON.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PATIENCE = 100.0  # [s]
CONFIGURATION = """<CycloneDDS><Domain>
  <General><AllowMulticast>false</AllowMulticast><Interfaces><NetworkInterface name="lo"/></Interfaces></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""


def struct(name: str, /, **fields: Any) -> Any:
    """A type of a ROS interface, "package/kind/Name", as its IDL would make it."""
    package, kind, own = name.split("/")
    return make_idl_struct(own, f"{package}::{kind}::dds_::{own}_", fields)


Time = struct("builtin_interfaces/msg/Time", sec=int32, nanosec=uint32)
Header = struct("std_msgs/msg/Header", stamp=Time, frame_id=str)
Clock = struct("rosgraph_msgs/msg/Clock", clock=Time)
JointState = struct(
    "sensor_msgs/msg/JointState",
    header=Header,
    name=sequence[str],
    position=sequence[float64],
    velocity=sequence[float64],
    effort=sequence[float64],
)
ModeCommand = struct(
    "vigir_humanoid_control_msgs/msg/VigirControlModeCommand", header=Header, requested_control_mode=str
)
ModeStatus = struct(
    "vigir_humanoid_control_msgs/msg/ControlModeStatus",
    header=Header,
    requested_control_mode=str,
    current_control_mode=str,
    status=uint32,
)


class Client:
    """Readers and writers of ROS topics."""

    def __init__(self, domain: int) -> None:
        self._domain = Domain(domain, CONFIGURATION)  # kept as long as the participant
        self._participant = DomainParticipant(domain)

    def reader(self, kind: type, name: str, durability: Any = Policy.Durability.Volatile) -> Any:
        return DataReader(self._participant, Topic(self._participant, name, kind), qos=_qos(1000, durability))

    def writer(self, kind: type, name: str) -> Any:
        qos = _qos(10, Policy.Durability.Volatile)
        return DataWriter(self._participant, Topic(self._participant, name, kind), qos=qos)


def _qos(depth: int, durability: Any) -> Qos:
    return Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(depth), durability)


def wait(condition: Callable[[], Any], what: str) -> Any:
    deadline = time.monotonic() + PATIENCE
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise TimeoutError(f"not within {PATIENCE:g} s: {what}")
        time.sleep(0.01)
    return value


def change_mode(client: Client, mode: str) -> str:
    """Request a control mode; returns the mode that the robot reports."""
    status = client.reader(ModeStatus, "rt/flor/controller/mode", Policy.Durability.TransientLocal)
    command = client.writer(ModeCommand, "rt/flor/controller/mode_command")
    wait(command.get_matched_subscriptions, "the VRC's reader of mode commands")
    command.write(ModeCommand(Header(Time(0, 0), ""), mode))
    reported = [""]

    def there() -> bool:
        reported.extend(message.current_control_mode for message in status.take(N=1000))
        return reported[-1] == mode

    wait(there, f"mode {mode}")
    return reported[-1]


def main() -> None:
    client = Client(int(os.environ["ROS_DOMAIN_ID"]))
    joints, clock = client.reader(JointState, "rt/joint_states"), client.reader(Clock, "rt/clock")
    ticks = wait(lambda: clock.take(N=1), "the clock")
    mode = change_mode(client, "stand_manipulate")
    states: list[Any] = []

    def gathered() -> bool:
        states.extend(joints.take(N=1000))
        return len(states) > 250

    wait(gathered, "a second of joint states")
    stamps = [each.header.stamp.sec * 10**9 + each.header.stamp.nanosec for each in states]
    found = {
        "joints": len(states[-1].name),
        "vectors": sorted({len(v) for s in states for v in (s.name, s.position, s.velocity, s.effort)}),
        "in order": stamps == sorted(stamps),
        "clock": ticks[0].clock.sec,
        "mode": mode,
        "ros": sorted(name for name in sys.modules if name.startswith("rclpy")),
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main()
