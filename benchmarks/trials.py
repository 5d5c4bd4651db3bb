"""What a robot does in a run of ``variants.py``, and how well: the table ``TRIALS``.

Each is driven as a person would, through ``valorctl``'s own parts and ROS 2 actions, and its figures compare with the
simulator's truth, which nobody else reads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import mujoco
import numpy as np

import bifrost
from benchmarks.live_system import System
from valor.common.errors import ValorError
from valor.common.messages import GroundTruth, Proprioceptor
from valor.common.poses import Pose, middle
from valor.common.topics import GROUND_TRUTH, PROPRIOCEPTOR
from valor.devices.dynamixel import Dynamixel
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.valorctl import arm_motion, stepping, watch
from valor.valorctl.arm_motion import SIDES, Limb, Side
from valor.valorctl.walking import Order, walk

M = TypeVar("M", bound=bifrost.Message)
STANDING = 8.0  # [robot time, s]
STEPS_TO = (0.6, 0.15, 0.5)  # forward, left [m], turned [rad]
PUSHES = ((15.0, 0.0), (0.0, 15.0), (20.0, 0.0), (0.0, -20.0))  # forward, left [N·s]
BETWEEN_PUSHES = 4.0  # [robot time, s]
LOOK_ASIDE = (-0.5, 0.25)  # neck: yaw, pitch [rad]
DEVICE_ROW = "valor: device "  # how the names of their rows in /diagnostics begin


class Bench:
    """One running system, and its truth."""

    def __init__(self, system: System, variant: str, robot: RobotDescription) -> None:
        self.system, self.variant, self.robot = system, variant, robot
        self.instance = system.instance
        self._truth: bifrost.Subscriber[GroundTruth] = GROUND_TRUTH.subscriber(system.node)
        self._measured: bifrost.Subscriber[Proprioceptor] = PROPRIOCEPTOR.subscriber(system.node)
        self._model = full_model(robot)

    def hear(self) -> None:
        """Take in what the system says; raises ValorError when it fell silent."""
        self.system.observer.hear()

    def wait(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        """Let robot time pass [s]; raises ValorError on a fall."""

        def fell(state: Any) -> bool:
            each()
            return bool(state.behavior == "fall")

        if self.system.observer.wait(fell, seconds):
            raise ValorError(f"fall: {self.system.observer.state.reason}")

    def truth(self) -> GroundTruth:
        """The newest from now on."""
        self._truth.latest()
        return _received(self._truth.receive(10.0), GROUND_TRUTH.name)

    def measured(self) -> Proprioceptor:
        """Likewise."""
        self._measured.latest()
        return _received(self._measured.receive(10.0), PROPRIOCEPTOR.name)

    def joint_error(self, goal: dict[str, float]) -> float:
        """Largest of some joints [mrad], once they had a moment to settle."""
        self.wait(0.5)
        position = self.measured().joint_position
        return 1e3 * max(abs(float(position[self.robot.index[joint]]) - wanted) for joint, wanted in goal.items())

    def soles(self) -> tuple[Pose, Pose]:
        """Where they truly are in the world: left, right."""
        truth, model, feet = self.truth(), self._model, self.robot.tables.feet
        data = mujoco.MjData(model.mj)
        data.qpos[:3], data.qpos[3:7] = truth.pelvis_position_in_world, truth.pelvis_orientation_in_world
        data.qpos[model.qpos] = truth.joint_position
        mujoco.mj_kinematics(model.mj, data)

        def pose(site: str) -> Pose:
            orientation = np.empty(4)
            mujoco.mju_mat2Quat(orientation, data.site(site).xmat)
            w, a, b, c = orientation.tolist()
            x, y, z = data.site(site).xpos.tolist()
            return Pose((x, y, z), (w, a, b, c))

        return pose(feet.left.sole), pose(feet.right.sole)

    def pelvis(self) -> Pose:
        """Where it truly is in the world."""
        truth = self.truth()
        x, y, z = truth.pelvis_position_in_world.tolist()
        w, a, b, c = truth.pelvis_orientation_in_world.tolist()
        return Pose((x, y, z), (w, a, b, c))


def _received(received: bifrost.Received[M] | None, topic: str) -> M:
    if received is None:
        raise ValorError(f"{topic} is silent for 10 s")
    return received.message


Values = Iterator[tuple[str, float]]


def stand(bench: Bench) -> Values:
    """Stand still; how far the pelvis strays over the ground."""
    places = []
    bench.wait(STANDING, lambda: places.append(bench.truth().pelvis_position_in_world[:2]))
    yield "stand: pelvis strays [mm]", 1e3 * float(np.linalg.norm(np.ptp(places, axis=0)))


def by_velocity(name: str, order: Order) -> Callable[[Bench], Values]:
    """Walk by velocity and stop; what of the way asked for is missing or too much, in truth."""

    def trial(bench: Bench) -> Values:
        before = bench.pelvis()
        result = walk(bench.instance, order, bench.hear)
        if result.reason:
            raise ValorError(result.reason)
        moved = before.inverse() @ bench.pelvis()
        assert order.seconds is not None
        if order.turn:
            yield f"{name}: turned [rad]", moved.yaw
        else:
            yield f"{name}: way [m]", math.hypot(*moved.position[:2])
        yield f"{name}: DCM error, mean [mm]", 1e3 * result.dcm_error

    return trial


def plan(bench: Bench) -> Values:
    """Footsteps through the Footstep Converter; how far the soles truly stand from where the plan has them."""
    soles = bench.soles()
    outcome = stepping.step_to(bench.instance, STEPS_TO, relative=True, check=bench.hear)
    if outcome.reason:
        raise ValorError(outcome.reason)
    bench.wait(1.0)
    to_world = middle(*soles) @ middle(*outcome.start).inverse()
    off = [(to_world @ wanted).inverse() @ is_ for (_, wanted), is_ in _last(outcome, bench.soles())]
    yield "plan: sole off, in truth [cm]", 1e2 * max(math.hypot(*each.position[:2]) for each in off)
    yield "plan: sole turned, in truth [°]", math.degrees(max(abs(each.yaw) for each in off))


def _last(outcome: stepping.Outcome, soles: tuple[Pose, Pose]) -> list[tuple[tuple[int, Pose], Pose]]:
    """Each foot's last step, and where its sole is."""
    wanted = dict(outcome.steps)
    return [((foot, wanted[foot]), soles[foot]) for foot in wanted]


def limbs(limb: Limb, presets: Sequence[str]) -> Callable[[Bench], Values]:
    """Arms or hands to presets by FollowJointTrajectory, one after the other; the worst joint at rest."""

    def trial(bench: Bench) -> Values:
        bench.system.mode("stand_manipulate")
        try:
            for side in SIDES:
                yield f"{side} {limb}: joint error [mrad]", max(_move(bench, side, limb, each) for each in presets)
        finally:
            bench.system.mode("stand")

    return trial


def _move(bench: Bench, side: Side, limb: Limb, name: str) -> float:
    arm_motion.move_limb(bench.instance, side, limb, name, speed=0.5, tolerance=1.0, check=bench.hear)
    return bench.joint_error(arm_motion.preset(bench.robot, side, limb, name))


def neck(bench: Bench) -> Values:
    """Look aside and ahead; the worst joint at rest."""
    joints = bench.robot.tables.groups["neck"]
    errors = []
    for angles in (LOOK_ASIDE, (0.0,) * len(joints)):
        goal = dict(zip(joints, angles, strict=True))
        arm_motion.follow(bench.instance, "neck", goal, 1.5, bench.hear)
        errors.append(bench.joint_error(goal))
    yield "neck: joint error [mrad]", max(errors)


def lidar(bench: Bench) -> Values:
    """What turns for ever, against the speed that robot.yaml sets; in simulation it obeys Motor."""
    if bench.variant != "hardware":
        return
    for joint, speed in _spinning(bench.robot):
        place, before = bench.robot.index[joint], bench.truth()
        bench.wait(3.0)
        after = bench.truth()
        elapsed = 1e-9 * (after.time - before.time)
        turned = float(after.joint_position[place] - before.joint_position[place])
        yield f"{joint}: speed off [%]", 100.0 * abs(turned / elapsed - speed) / abs(speed)


def _spinning(robot: RobotDescription) -> Iterator[tuple[str, float]]:
    for device in robot.tables.devices.values():
        if isinstance(device, Dynamixel):
            yield from ((servo.joint, servo.spin) for servo in device.servos if servo.spin is not None)


def pushes(bench: Bench) -> Values:
    """Pushed at the chest, standing; the robot may step."""
    observer, errors = bench.system.observer, [0.0]

    def note() -> None:
        off = observer.state.dcm_in_odom - observer.state.dcm_reference_in_odom
        errors.append(float(np.hypot(off[0], off[1])))

    for x, y in PUSHES:
        heading = bench.pelvis().yaw
        c, s = math.cos(heading), math.sin(heading)
        bench.system.push((c * x - s * y, s * x + c * y, 0.0))
        bench.wait(BETWEEN_PUSHES, note)
    yield "pushed: DCM error, most [mm]", 1e3 * max(errors)


def told(bench: Bench) -> Values:
    """What ``status`` and ``/diagnostics`` say when all is well: processes not ready, restarts, units not well."""
    look = watch.look(bench.instance)
    yield "real-time factor", bench.system.observer.timeliness()["real_time_factor"]
    yield "status: not ready, or restarted", sum(each.state != "ready" or each.restarts > 0 for each in look.services)
    if bench.variant == "hardware":
        rows = _device_rows(bench)
        expected = sum(max(1, len(device.units)) for device in bench.robot.tables.devices.values())
        ailing = [f"{name.removeprefix(DEVICE_ROW)}: {text}" for name, (level, text) in rows.items() if level]
        yield "/diagnostics: units missing or not well", expected - len(rows) + len(ailing)
        if ailing:
            raise ValorError(", ".join(ailing))


def _device_rows(bench: Bench) -> dict[str, tuple[int, str]]:
    """Level and words of each unit by ``/diagnostics``; of those that say all that there is to say."""
    from diagnostic_msgs.msg import DiagnosticArray

    from valor.valorctl.ros_client import RosClient

    rows: dict[str, tuple[int, str]] = {}
    whole = {"rate [Hz]", "latency [ms]", "age [ms]"}

    def hear(message: DiagnosticArray) -> None:  # drivers publish there, too
        for row in message.status:
            if row.name.startswith(DEVICE_ROW) and {pair.key for pair in row.values} >= whole:
                rows[row.name] = row.level[0], row.message

    with RosClient(bench.instance, bench.hear) as ros:
        ros.subscribe(DiagnosticArray, "/diagnostics", hear, 10)
        ros.wait(lambda: bool(rows), 10.0, "/diagnostics: no unit of a device")
    return rows


TRIALS: dict[str, Callable[[Bench], Values]] = {
    "stand": stand,
    "walk": by_velocity("walk 0.3 m/s, 5 s", Order(0.3, seconds=5.0)),
    "turn": by_velocity("turn 0.3 rad/s, 4 s", Order(turn=0.3, seconds=4.0)),
    "sideways": by_velocity("sideways 0.1 m/s, 5 s", Order(left=0.1, seconds=5.0)),
    "plan": plan,
    "arms": limbs("arm", ("forward", "side", "home")),
    "hands": limbs("hand", ("close", "open")),
    "neck": neck,
    "lidar": lidar,
    "pushes": pushes,
    "told": told,
}
