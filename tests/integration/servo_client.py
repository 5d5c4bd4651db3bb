"""Stands in for the Motion Manager: answers each Proprioceptor with the nominal posture, on the joints' own servos.

Used in process by tests; as a process of its own (``python -m tests.integration.servo_client``) where it is to be
stopped or killed.
"""

import time
from collections.abc import Callable

import bifrost
from harness.motion_states import motor
from valor.common.instance import Instance
from valor.common.messages import Motor, Proprioceptor
from valor.common.topics import MOTOR, PROPRIOCEPTOR
from valor.robot.description import RobotDescription


class ServoClient:
    """One that leads from when it begins."""

    def __init__(self, node: bifrost.Node, robot: RobotDescription, keep: bool = False) -> None:
        self._motor = MOTOR.publisher(node)
        self.proprioceptor = PROPRIOCEPTOR.subscriber(node)
        self._robot = robot
        self._keep = keep
        self._began = time.monotonic_ns()
        self.states: list[Proprioceptor] = []
        self.sequence = 0

    def command(self, state: Proprioceptor) -> Motor:
        self.sequence += 1
        return motor(
            self._robot, time=state.time, sequence=self.sequence, proprioceptor_sequence=state.sequence,
            behavior="stand_prep", writer=self._began,
        )  # fmt: skip

    def publish(self, message: Motor) -> None:
        self._motor.publish(message)

    def hear(self, timeout: float = 60.0) -> Proprioceptor:
        received = self.proprioceptor.receive(timeout=timeout)
        assert received is not None, f"no Proprioceptor within {timeout:g} s"
        if self._keep:
            self.states.append(received.message)
        return received.message

    def answer_until(self, done: Callable[[Proprioceptor], bool], timeout: float = 300.0) -> Proprioceptor:
        """Answer every state until one satisfies ``done``, which is returned unanswered."""
        deadline = time.monotonic() + timeout
        while not done(state := self.hear()):
            self.publish(self.command(state))
            assert time.monotonic() < deadline, f"not within {timeout:g} s"
        return state

    def run_to(self, robot_time: float, timeout: float = 300.0) -> Proprioceptor:
        """Answer every state until a robot time [s]."""
        return self.answer_until(lambda state: state.time >= robot_time * 1e9, timeout)


def main() -> None:
    instance = Instance.from_environment()
    network = bifrost.Network.load(instance.network_file, instance.keys)
    with bifrost.Node("servo_client", network=network) as node:
        client = ServoClient(node, RobotDescription.load(instance.settings().robot))
        client.answer_until(lambda _: False, timeout=600.0)


if __name__ == "__main__":
    main()
