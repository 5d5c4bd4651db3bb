"""A whole system under its supervisor, driven through ``valorctl`` as a person would, and a ROS 2 client beside it."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

TRAJECTORY_ACTION = "trajectory_controllers/{}_traj_controller/follow_joint_trajectory"
Point = tuple[float, Mapping[str, float]]  # time from start [s], joint → position [rad]
VALORCTL = Path(sys.executable).with_name("valorctl")


class System:
    """An instance that ``valorctl`` starts and stops."""

    def __init__(self, name: str, home: Path) -> None:
        self.name = name
        self.environment = os.environ | {"VALOR_HOME": str(home), "VALOR_INSTANCE": name}

    def valorctl(
        self, *arguments: str, expect: int = 0, timeout: float = 120.0, folder: Path = Path("/")
    ) -> subprocess.CompletedProcess[str]:
        """Run one verb in a folder; its exit status must be ``expect``."""
        result = subprocess.run(
            [str(VALORCTL), *arguments],
            env=self.environment,
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=timeout,
            stdin=subprocess.DEVNULL,
            check=False,
        )
        assert result.returncode == expect, (
            f"valorctl {' '.join(arguments)}: exit {result.returncode}, expected {expect}\n"
            f"{result.stdout}\n{result.stderr}"
        )
        return result

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        """Start one verb."""
        return subprocess.Popen(
            [str(VALORCTL), *arguments], env=self.environment, cwd="/", stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def status(self) -> dict[str, Any]:
        """``valorctl status --json``."""
        answer: dict[str, Any] = json.loads(self.valorctl("status", "--json").stdout)
        return answer

    def join(self) -> dict[str, str]:
        """What ``valorctl env`` exports, read as a shell would."""
        script = f'eval "$({VALORCTL} env)" && env -0'
        output = subprocess.run(
            ["bash", "-c", script], env=self.environment, capture_output=True, text=True, check=True
        ).stdout
        return dict(line.split("=", 1) for line in output.split("\0") if "=" in line)


@contextmanager
def running(name: str, home: Path, *options: str) -> Iterator[System]:
    """``valorctl up`` with options; ``valorctl down`` whatever happens."""
    system = System(name, home)
    try:
        system.valorctl("up", *options)
        yield system
    finally:
        system.valorctl("down")


def in_executor(executor: Any, function: Callable[..., Any], *arguments: Any, **more: Any) -> Any:
    """Call a function of an action client in the thread that spins it.

    A client notes what it has sent after sending it: an answer that another thread takes in between is thrown away as
    unexpected.
    """
    answer: queue.SimpleQueue[Any] = queue.SimpleQueue()
    executor.create_task(lambda: answer.put(function(*arguments, **more)))
    return answer.get(timeout=60.0)


class RosClient:
    """An ordinary ROS 2 node that knows only public names; spins in a thread of its own."""

    def __init__(
        self, environment: Mapping[str, str], *, joint_states: bool = True, namespace: str | None = None
    ) -> None:
        """Join; without ``joint_states``, 250 a second, there are no ``joint_positions``."""
        for key in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS"):
            os.environ[key] = environment[key]
        import rclpy
        from control_msgs.action import FollowJointTrajectory
        from rclpy.action import ActionClient
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from sensor_msgs.msg import JointState
        from vigir_humanoid_control_msgs.action import ChangeControlMode
        from vigir_humanoid_control_msgs.msg import ControlModeStatus

        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=int(environment["ROS_DOMAIN_ID"]))
        self.node = rclpy.create_node("test_client", context=self._context, namespace=namespace)
        self.reports: list[ControlModeStatus] = []
        self.joint_state: JointState | None = None
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(ControlModeStatus, "flor/controller/mode", self.reports.append, latched)
        self._mode = ActionClient(
            self.node, ChangeControlMode, "mode_controllers/control_mode_controller/change_control_mode"
        )
        self._trajectory = {
            name: ActionClient(self.node, FollowJointTrajectory, TRAJECTORY_ACTION.format(name))
            for name in ("left_arm", "right_arm", "neck", "left_hand", "right_hand", "left_leg", "pelvis")
        }
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        if joint_states:
            self._call(self.node.create_subscription, JointState, "joint_states", self._keep_joint_state, 10)

    def _spin(self) -> None:
        while self._context.ok() and not self._closing.is_set():
            self._executor.spin_once(timeout_sec=0.1)

    def _keep_joint_state(self, message: Any) -> None:
        self.joint_state = message

    def joint_positions(self) -> dict[str, float]:
        """The newest joint positions [rad]; waits for the first."""
        deadline = time.monotonic() + 10.0
        while self.joint_state is None:
            assert time.monotonic() < deadline, "no /joint_states within 10 s"
            time.sleep(0.01)
        return dict(zip(self.joint_state.name, self.joint_state.position, strict=True))

    def change_mode(self, mode: str, timeout: float = 60.0) -> Any:
        """The ControlModeStatus that the action ends with."""
        from vigir_humanoid_control_msgs.action import ChangeControlMode

        return self._run(self._mode, ChangeControlMode.Goal(mode_request=mode), timeout).result.result

    def follow(self, controller: str, points: Sequence[Point], timeout: float = 60.0) -> Any:
        """The FollowJointTrajectory result for some points."""
        from builtin_interfaces.msg import Duration
        from control_msgs.action import FollowJointTrajectory
        from trajectory_msgs.msg import JointTrajectoryPoint

        goal = FollowJointTrajectory.Goal()
        goal.trajectory.joint_names = list(points[0][1])
        for at, positions in points:
            nanoseconds = round(at * 1e9)
            goal.trajectory.points.append(
                JointTrajectoryPoint(
                    positions=list(positions.values()),
                    time_from_start=Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9),
                )
            )
        return self._run(self._trajectory[controller], goal, timeout)

    def _run(self, client: Any, goal: Any, timeout: float) -> Any:
        name = client._action_name
        assert client.wait_for_server(timeout_sec=timeout), f"no action server {name}"
        handle = self._wait(self._call(client.send_goal_async, goal), timeout, f"{name} to answer the goal")
        assert handle.accepted, f"{name} rejected the goal without a result"
        return self._wait(self._call(handle.get_result_async), timeout, f"{name} to end")

    def _call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call in the executor's thread: what another one destroys may be waited for at that moment."""
        return in_executor(self._executor, function, *arguments)

    def destroy(self, destroy: Callable[[Any], object], entity: Any) -> None:
        """Have a subscription, publisher or client end in the executor's thread.

        That one may be about to wait for it or its events, which ends the executor where it finds them destroyed.
        """
        self._call(destroy, entity)

    @staticmethod
    def _wait(future: Any, timeout: float, what: str) -> Any:
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(timeout), f"not within {timeout:g} s: {what}"
        return future.result()

    def close(self) -> None:
        """Leave ROS."""
        self._closing.set()  # first: an executor that is shut down while it takes a message raises
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.shutdown()


def shared_memory() -> set[str]:
    """Files of Fast DDS' shared memory on this machine."""
    return {entry for entry in os.listdir("/dev/shm") if re.search(r"fastrtps|fastdds", entry)}


def _held() -> set[str]:
    """Names of the files in /dev/shm that a process has mapped or open."""
    found: set[str] = set()
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has ended, or is another user's
            found.update(re.findall(r"/dev/shm/(\S+)", (process / "maps").read_text()))
            for descriptor in (process / "fd").iterdir():
                with contextlib.suppress(OSError):  # it has just been closed
                    found.add(descriptor.readlink().name)
    return found


def leftovers(home: Path, name: str, shared_memory_before: set[str]) -> list[str]:
    """What an instance that is down has left: processes, sockets, keys, shared memory that no process holds.

    Shared memory that was there before is others', also where it was held then and is not any more.
    """
    import psutil

    found: list[str] = []
    for process in psutil.process_iter(["pid", "name"]):
        try:
            variables = process.environ()
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            continue
        ours = variables.get("VALOR_INSTANCE") == name and variables.get("VALOR_HOME") == str(home)
        if ours and process.pid != os.getpid() and process.status() != psutil.STATUS_ZOMBIE:
            found.append(f"process {process.pid} {process.name()}")
    found += [str(path) for path in (home / name).rglob("*") if path.is_socket() or "key" in path.name]
    # Twice: of what others have closed meanwhile, the list is older than the processes.
    unheld = [shared_memory() - shared_memory_before - _held() for _ in range(2)]
    return found + [f"/dev/shm/{entry}" for entry in set.intersection(*unheld)]
