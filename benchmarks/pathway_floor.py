"""The other end of the floor that ``pathways.py`` measures: a bare process that sends both payloads.

python benchmarks/pathway_floor.py JOINTS BYTES
"""

from __future__ import annotations

import itertools
import sys
import time
from struct import Struct
from typing import Any

import zmq

RATE = 250.0  # of the messages, as of /joint_states [Hz]
STAMP = Struct("<q")
FLOOR_STATE, FLOOR_ACTION = "/floor/joint_states", "/floor/change_control_mode"


def joint_state(n: int) -> Any:
    """A message as large as the robot's."""
    from sensor_msgs.msg import JointState

    zeros = [0.0] * n
    return JointState(name=[f"l_some_joint_{i}" for i in range(n)], position=zeros, velocity=zeros, effort=zeros)


def serve(n: int, size: int) -> None:
    """Publish both payloads, each with the time of sending in it, and finish every action goal at once."""
    import rclpy
    from rclpy.action import ActionServer
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import JointState
    from vigir_humanoid_control_msgs.action import ChangeControlMode

    def execute(handle: Any) -> Any:
        handle.succeed()
        return ChangeControlMode.Result()

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # SIGTERM ends it, without a word
    node = rclpy.create_node("floor", enable_rosout=False, start_parameter_services=False)
    _server = ActionServer(node, ChangeControlMode, FLOOR_ACTION, execute)
    publisher = node.create_publisher(JointState, FLOOR_STATE, 5)
    message, payload = joint_state(n), bytes(size)
    socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.PUB)
    socket.bind("tcp://127.0.0.1:*")
    print(socket.getsockopt_string(zmq.LAST_ENDPOINT), flush=True)

    def publish() -> None:
        socket.send(STAMP.pack(time.monotonic_ns()) + payload)

    def publish_ros() -> None:
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.monotonic_ns(), 10**9)
        publisher.publish(message)

    executor = SingleThreadedExecutor()
    executor.add_node(node)
    due = time.monotonic()
    for send in itertools.cycle((publish, publish_ros)):
        send()
        due += 0.5 / RATE
        while (left := due - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left)


if __name__ == "__main__":
    serve(*map(int, sys.argv[1:]))
