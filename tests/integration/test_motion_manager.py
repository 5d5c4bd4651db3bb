"""The Motion System as it runs: bifrostd, Comms Manager and Motion Manager as processes, and a client beside them."""

from __future__ import annotations

import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest

from harness.instance import RunningInstance, fresh_instance
from harness.places import ROBOTS
from harness.waiting import wait_until
from valor.common.behaviors import REFLEX, Behavior
from valor.common.messages import (
    BehaviorReply,
    BehaviorRequest,
    Footstep,
    FootstepPlanRequest,
    JointMode,
    JointSetpoints,
    MotionState,
    Proprioceptor,
    PushRequest,
    Rejection,
    VelocityCommand,
)
from valor.common.topics import (
    BEHAVIOR,
    FOOTSTEP_PLAN,
    GROUND_TRUTH,
    JOINT_SETPOINTS,
    MOTION_STATE,
    MOTOR,
    PROPRIOCEPTOR,
    PUSH,
    REJECTION,
    STATISTICS,
    STOP,
    VELOCITY,
)
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
ARM = ROBOT.tables.groups["right_arm"]
ARM_PLACES = ROBOT.group_indices("right_arm")
FORWARD = np.array([ROBOT.tables.arm_presets["forward"]["right"][name] for name in ARM])
LEGS = {*ROBOT.tables.groups["left_leg"], *ROBOT.tables.groups["right_leg"]}
HELD = 0.05  # of a joint that is held while nobody commands it: it sags a little [rad]
DAMPING = np.where([table.control == "position" for table in ROBOT.tables.joints.values()], 0.0, ROBOT.servo_damping)
DRIVEN = 15.0  # at most so much are joints that are let go, by the sensors' noise [N·m]
FEW = 10  # Motors
FALLING = 30.0  # likewise ones that move, whose velocity is not measured when their effort is [N·m]
FLOODED = f"flooder floods {JOINT_SETPOINTS.name}"
MISSED = 50  # periods in a row that a busy machine may cost
STANDING = 0.7  # the pelvis of a standing robot is higher [m]


class MotionSystem:
    """Comms Manager and Motion Manager of an instance, and what a client can see of them and ask for."""

    def __init__(self, instance: RunningInstance, *, env: dict[str, str] | None = None) -> None:
        self.instance = instance
        node = instance.node()
        self._states = MOTION_STATE.subscriber(node, queue=20_000)
        self._truth = GROUND_TRUTH.subscriber(node)
        self._rejections = REJECTION.subscriber(node, queue=1000)
        self._statistics = STATISTICS["motion_manager"].subscriber(node)
        self.motors = MOTOR.subscriber(node)
        self._setpoints = JOINT_SETPOINTS.publisher(node)
        self._velocity = VELOCITY.publisher(node)
        self._behavior = BEHAVIOR.client(node)
        self._footsteps = FOOTSTEP_PLAN.client(node)
        self._push = PUSH.client(node)
        self.history: list[MotionState] = []
        self.rejections: list[Rejection] = []
        self._height: float | None = None
        instance.start("comms_manager", env=env)
        instance.start("motion_manager", env=env)
        instance.wait_ready("motion_manager")

    def look(self) -> MotionState | None:
        """The newest MotionState; all are kept in ``history``."""
        self.history += [received.message for received in self._states.drain()]
        self.rejections += [received.message for received in self._rejections.drain()]
        if (truth := self._truth.latest()) is not None:
            self._height = float(truth.message.pelvis_position_in_world[2])
        return self.history[-1] if self.history else None

    @property
    def height(self) -> float:
        """Of the true pelvis [m]."""
        self.look()
        return wait_until(lambda: self.look() and self._height, 10.0, "the simulator's truth") or 0.0

    def counts_at_least(self, rejected: int) -> bool:
        """Whether its newest statistics, which come once a second, have so many refusals."""
        told = self._statistics.latest()
        return told is not None and told.message.rejected >= rejected

    def wait(self, condition: Callable[[MotionState], bool], what: str, timeout: float = 60.0) -> MotionState:
        def seen() -> MotionState | None:
            state = self.look()
            return state if state is not None and condition(state) else None

        state = wait_until(seen, timeout, what)
        assert state is not None
        return state

    def wait_behavior(self, behavior: Behavior, timeout: float = 60.0) -> MotionState:
        return self.wait(lambda state: state.behavior == behavior, f"behavior {behavior}", timeout)

    def pass_time(self, seconds: float) -> MotionState:
        """Let robot time pass [s]."""
        until = self.now() + round(seconds * 1e9)
        return self.wait(lambda state: state.time >= until, f"{seconds} s of robot time")

    def now(self) -> int:
        """Robot time [ns]."""
        state = self.look()
        return 0 if state is None else state.time

    def request(self, behavior: str) -> BehaviorReply:
        return self._behavior.call(BehaviorRequest(behavior=behavior), timeout=10.0)

    def go(self, behavior: Behavior) -> MotionState:
        """Ask until it is accepted: Stand is, once Stand Prep has finished."""
        wait_until(lambda: self.request(behavior).accepted, 60.0, f"{behavior} accepted", period=0.1)
        return self.wait_behavior(behavior)

    def stand(self) -> MotionState:
        return self.go(Behavior.STAND)

    def send(self, setpoints: Mapping[str, float], age: float = 0.0, **changes: object) -> None:
        """One message of set-points, as of now."""
        message = JointSetpoints(
            time=self.now() - round(age * 1e9),
            names=list(setpoints),
            position=np.array(list(setpoints.values()), dtype=float),
            velocity=np.zeros(len(setpoints)),
            acceleration=np.zeros(len(setpoints)),
        )
        for name, value in changes.items():
            setattr(message, name, value)
        self._setpoints.publish(message)

    def walk_on_one_foot(self, seconds: float) -> None:
        """Walk ahead at 0.3 m/s, at least so long [robot time], until a foot is in the air."""
        self.go(Behavior.WALK)
        until = self.now() + round(seconds * 1e9)

        def step() -> bool:
            self._velocity.publish(VelocityCommand(self.now(), 0.3, 0.0, 0.0))
            state = self.look()
            return state is not None and state.time > until and state.contacts.sum() == 1

        wait_until(step, 60.0, "a foot in the air", period=0.02)

    def lead(self, setpoints: Mapping[str, float], until: Callable[[MotionState], bool], what: str) -> MotionState:
        """Stream set-points until something is so."""

        def step() -> MotionState | None:
            self.send(setpoints)
            state = self.look()
            return state if state is not None and until(state) else None

        state = wait_until(step, 60.0, what, period=0.004)
        assert state is not None
        return state

    def refused(self, reason: str, **message: object) -> None:
        """Send set-points again and again until they are seen to be refused for a reason."""

        def step() -> bool:
            self.send(message.get("setpoints", {"neck_yaw": 0.1}), **message.get("changes", {}))  # type: ignore[arg-type]
            self.look()
            return any(reason in rejection.reason for rejection in self.rejections)

        wait_until(step, 20.0, f"a rejection with {reason!r}; seen: {[r.reason for r in self.rejections]}")

    def push(self, impulse: tuple[float, float, float]) -> None:
        reply = self._push.call(PushRequest(impulse_in_world=np.array(impulse), duration=0.1), timeout=10.0)
        assert reply.accepted, reply.reason

    def forget(self) -> None:
        """What was seen so far, but for the newest MotionState."""
        self.look()
        self.history, self.rejections = self.history[-1:], []

    def behaviors(self) -> list[str]:
        """Every behavior seen, in order."""
        self.look()
        seen: list[str] = []
        for state in self.history:
            if not seen or seen[-1] != state.behavior:
                seen.append(state.behavior)
        return seen


def largest_steps(history: list[MotionState], places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Greatest change of the commanded positions per second of robot time, between consecutive states."""
    time = np.array([state.time for state in history]) * 1e-9
    position = np.array([state.joint_setpoint[places] for state in history])
    elapsed = np.diff(time)[:, None]
    consecutive = (elapsed > 0.0)[:, 0]
    return elapsed[consecutive], np.abs(np.diff(position, axis=0))[consecutive]


def test_a_killed_comms_manager_is_a_fall_with_its_reason(instance: RunningInstance) -> None:
    system = MotionSystem(instance)
    system.stand()
    instance.kill("comms_manager")
    instance.start("comms_manager")
    fallen = system.wait_behavior(Behavior.FALL)
    assert "another world" in fallen.reason
    assert not system.request("stand").accepted


def test_a_comms_manager_killed_in_stand_prep_moves_nothing_until_told_to(instance: RunningInstance) -> None:
    system = MotionSystem(instance)
    system.pass_time(0.5)
    instance.kill("comms_manager")
    wait_until(lambda: "silent" in system.request("get_up").reason, 20.0, "requests answered: no robot")
    instance.start("comms_manager")
    assert "another world" in system.wait_behavior(Behavior.FREEZE).reason
    system.go(Behavior.STAND_PREP)
    system.stand()
    system.pass_time(0.5)
    assert system.height > STANDING


def killed_and_back(system: MotionSystem) -> list[Proprioceptor]:
    """Kill the Motion Manager and start it anew; what was measured from just before until it has the robot again."""
    measured = PROPRIOCEPTOR.subscriber(system.instance.node("witness"), queue=20_000)
    seen = [wait_until(measured.latest, 20.0, "a Proprioceptor").message]
    system.instance.kill("motion_manager")
    system.instance.start("motion_manager", wait=True)
    system.pass_time(0.5)
    return seen + [received.message for received in measured.drain()]


def driven(measured: list[Proprioceptor]) -> float:
    """The greatest effort of any joint beside its damping [N·m]."""
    return max(float(np.abs(each.joint_effort + DAMPING * each.joint_velocity).max()) for each in measured)


def moved(measured: list[Proprioceptor]) -> float:
    """How far any joint of the upper body has come from where it was at first [rad]."""
    places = [place for place in range(len(ROBOT.joints)) if ROBOT.joints[place] not in LEGS]
    return max(float(np.abs((each.joint_position - measured[0].joint_position)[places]).max()) for each in measured)


def test_whoever_is_killed_no_joint_moves_until_somebody_commands_it(instance: RunningInstance) -> None:
    """Frozen with an arm up, standing, and fallen: one robot, whose Motion Manager dies again and again."""
    instance.configure(real_time_factor=1.0)  # the robot lives on while the Motion Manager starts
    system = MotionSystem(instance)
    system.stand()
    system.go(Behavior.STAND_MANIPULATE)
    up = dict(zip(ARM, FORWARD, strict=True))
    system.lead(up, lambda state: bool(np.allclose(state.joint_setpoint[ARM_PLACES], FORWARD, atol=0.05)), "an arm up")
    system.go(Behavior.FREEZE)
    system.pass_time(1.0)  # the arm comes to rest
    for _ in range(2):
        assert moved(killed_and_back(system)) < HELD
        assert "before, the robot was in freeze" in system.wait_behavior(Behavior.FREEZE).reason
    system.go(Behavior.STAND_PREP)
    system.stand()
    assert moved(killed_and_back(system)) < HELD
    assert "before, the robot was in stand" in system.wait_behavior(Behavior.FREEZE).reason
    assert system.height > STANDING
    system.go(Behavior.STAND_PREP)
    system.stand()

    system.push((0.0, 80.0, 0.0))
    system.wait_behavior(Behavior.FALL)
    system.pass_time(3.0)
    limp = killed_and_back(system)
    assert "before, the robot was in fall" in system.wait_behavior(Behavior.FALL).reason
    assert system.height < 0.5
    assert driven(limp) < DRIVEN
    assert "stay limp" in instance.log("comms_manager")


def test_whoever_is_killed_or_stopped_in_the_middle_of_a_step_the_robot_comes_to_stand(
    instance: RunningInstance,
) -> None:
    instance.configure(real_time_factor=1.0, actuators="hardware")
    system = MotionSystem(instance)
    witness = instance.node("witness")
    measured = PROPRIOCEPTOR.subscriber(witness)
    statistics = STATISTICS["comms_manager"].subscriber(witness)

    def rejected() -> int:
        statistics.latest()
        return wait_until(statistics.latest, 20.0, "new statistics").message.rejected

    def last_led_by() -> str:
        return wait_until(measured.latest, 20.0, "a Proprioceptor").message.motor_behavior

    def stopped_and_continued() -> None:
        process = system.instance.process("motion_manager")
        process.send_signal(signal.SIGSTOP)
        try:
            wait_until(lambda: last_led_by() == REFLEX, 30.0, "the reflex")
            wait_until(lambda: last_led_by() == "walk", 30.0, "its end")
            refused = rejected()
        finally:
            process.send_signal(signal.SIGCONT)
        system.wait_behavior(Behavior.FREEZE)
        assert rejected() - refused < FEW, "it answers the newest state, not all that came meanwhile"

    ways: tuple[tuple[Callable[[], object], tuple[str, ...]], ...] = (
        # The next one may find the reflex at it, or done.
        (lambda: killed_and_back(system), ("before, the robot was in walk", "it stands, and is held")),
        (stopped_and_continued, ("it stands, and is held",)),
    )
    for what, reasons in ways:
        system.go(Behavior.STAND_PREP)
        system.stand()
        system.walk_on_one_foot(3.0)
        what()
        reason = system.wait_behavior(Behavior.FREEZE).reason
        assert any(expected in reason for expected in reasons), reason
        assert system.pass_time(1.0).behavior == Behavior.FREEZE
        assert system.height > STANDING
    assert "it stands, after" in instance.log("comms_manager")

    # Whoever wants it limp while nobody but the reflex is there has it limp.
    system.go(Behavior.STAND_PREP)
    system.stand()
    system.walk_on_one_foot(1.0)
    instance.kill("motion_manager")
    wait_until(lambda: last_led_by() == REFLEX, 30.0, "the reflex")
    reply = (
        instance.node("somebody")
        .client(STOP.name, BehaviorRequest, BehaviorReply)
        .call(BehaviorRequest("fall"), timeout=10.0)
    )
    assert (reply.accepted, reply.behavior) == (True, "fall")
    wait_until(lambda: last_led_by() == "fall", 30.0, "what was asked for")
    sinking = [wait_until(measured.latest, 20.0, "a Proprioceptor").message for _ in range(10)]
    assert {each.motor_behavior for each in sinking} == {"fall"}
    assert driven(sinking[5:]) < FALLING
    instance.start("motion_manager", wait=True)
    assert "before, the robot was in fall" in system.wait_behavior(Behavior.FALL).reason


def test_both_managers_killed_the_robot_is_not_brought_to_its_feet(instance: RunningInstance) -> None:
    """The simulated one begins in the air, as a robot that was lifted meanwhile: it is not known to stand."""
    system = MotionSystem(instance)
    system.stand()
    instance.kill("motion_manager")
    instance.kill("comms_manager")
    instance.start("comms_manager")
    instance.start("motion_manager", wait=True)
    assert "before, the robot was in stand; the left foot carries" in system.wait_behavior(Behavior.FALL).reason
    assert "stand_prep" not in system.behaviors()[-2:]


def test_the_motion_system_runs_where_ros_cannot_be_imported(instance: RunningInstance, tmp_path: Path) -> None:
    marker = tmp_path / "blocked"
    (tmp_path / "sitecustomize.py").write_text(
        "import pathlib, os, sys\n"
        "ROS = {'rclpy', 'rosidl_runtime_py', 'std_msgs', 'sensor_msgs', 'builtin_interfaces', 'ament_index_python'}\n"
        "class Blocker:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.split('.')[0] in ROS:\n"
        "            raise ModuleNotFoundError(f'No module named {name!r}: ROS is not installed here')\n"
        "sys.meta_path.insert(0, Blocker())\n"
        f"pathlib.Path({str(marker)!r} + f'-{{os.getpid()}}').touch()\n"
    )
    system = MotionSystem(instance, env={"PYTHONPATH": str(tmp_path)})
    for name in ("comms_manager", "motion_manager"):
        assert Path(f"{marker}-{instance.process(name).pid}").exists(), f"{name} ran without the blocker"
    system.stand()
    system.pass_time(1.0)
    assert system.height > STANDING


@pytest.fixture(scope="module")
def started() -> Iterator[MotionSystem]:
    """One system for those behind, each of which leaves the robot standing; but for the last two."""
    with (
        tempfile.TemporaryDirectory(prefix="valor-", ignore_cleanup_errors=True) as home,
        fresh_instance(Path(home)) as running,
    ):
        yield MotionSystem(running)


@pytest.fixture
def system(started: MotionSystem) -> MotionSystem:
    """It, standing; what others have seen of it is forgotten."""
    started.stand()
    started.forget()
    return started


def test_stand_prep_answers_why_stand_is_refused(started: MotionSystem) -> None:
    """The first in the shared system: it has just started."""
    refusals = []

    def accepted() -> bool:
        reply = started.request("stand")
        if not reply.accepted:
            assert reply.behavior == Behavior.STAND_PREP
            refusals.append(reply.reason)
        return reply.accepted

    wait_until(accepted, 60.0, "stand accepted")
    assert refusals
    assert all("stand_prep" in reason or "foot" in reason for reason in refusals), refusals


def test_escher_gets_ready_stands_gives_its_arms_away_and_takes_them_back(system: MotionSystem) -> None:
    system.pass_time(1.0)
    system.go(Behavior.STAND_MANIPULATE)
    held = system.pass_time(0.5).joint_setpoint[ARM_PLACES]
    assert np.allclose(held, ROBOT.nominal_posture[ARM_PLACES], atol=0.03)  # nobody led them yet
    arrived = system.lead(
        dict(zip(ARM, FORWARD, strict=True)),
        lambda state: bool(np.allclose(state.joint_setpoint[ARM_PLACES], FORWARD, atol=0.05)),
        "the right arm forward",
    )
    assert arrived.behavior == Behavior.STAND_MANIPULATE
    system.go(Behavior.STAND)
    system.wait(
        lambda state: bool(np.allclose(state.joint_setpoint[ARM_PLACES], ROBOT.nominal_posture[ARM_PLACES], atol=0.05)),
        "the right arm at home",
    )
    assert system.height > STANDING
    assert system.behaviors()[-3:] == ["stand", "stand_manipulate", "stand"]
    assert not any(state.qp_failures for state in system.history)
    arms = np.concatenate((ARM_PLACES, ROBOT.group_indices("left_arm")))
    elapsed, steps = largest_steps(system.history, arms)
    assert (steps <= ROBOT.velocity_limit[arms] * elapsed * 1.05 + 1e-6).all()
    sequences = [state.proprioceptor_sequence for state in system.history]
    assert sequences == sorted(sequences)
    # What is told of a tick contains the part until its Motor, which the MotionState before told.
    pairs = [
        (before.motor_time, state.tick_time)
        for before, state in zip(system.history, system.history[1:], strict=False)
        if state.proprioceptor_sequence == before.proprioceptor_sequence + 1
    ]
    assert len(pairs) > 100 and all(0.0 < motor_time < tick_time for motor_time, tick_time in pairs)


def test_commands_are_refused_with_their_reasons_and_the_robot_stands_on(system: MotionSystem) -> None:
    assert "unknown behavior 'moonwalk'; expected one of idle, stand_prep" in system.request("moonwalk").reason
    assert "no transition from stand to idle" in system.request("idle").reason
    before = system.pass_time(1.0).joint_setpoint
    arm = dict.fromkeys(ARM, 0.0)
    system.refused("closed to set-points in behavior stand: manipulation is slave", setpoints=arm)
    system.refused("they carry the robot", setpoints={"l_knee_pitch": 1.0})
    system.refused("unknown joint 'tail'", setpoints={"tail": 1.0})
    system.refused("is nan, not a finite number", setpoints={"neck_yaw": np.nan})
    system.refused("position has 3 numbers", changes={"position": np.zeros(3)})
    system.refused("stale", changes={"age": 1.0})
    reply = system._footsteps.call(
        FootstepPlanRequest(steps=[Footstep(1, 0, np.zeros(3), np.array([1.0, 0, 0, 0]), 0.0, 0.0, 0.0)]), timeout=10.0
    )
    assert not reply.accepted
    assert "step_manipulate; the behavior is stand" in reply.reason
    after = system.pass_time(0.5)
    assert after.behavior == Behavior.STAND
    arms = np.concatenate((ARM_PLACES, ROBOT.group_indices("left_arm"), ROBOT.group_indices("neck")))
    assert np.allclose(after.joint_setpoint[arms], before[arms], atol=0.02)
    assert system.height > STANDING
    refused = {rejection.topic: rejection.count for rejection in system.rejections}
    assert set(refused) == {BEHAVIOR.name, JOINT_SETPOINTS.name, FOOTSTEP_PLAN.name}
    wait_until(lambda: system.counts_at_least(sum(refused.values())), 20.0, "all are counted")


def test_soft_stop_keeps_balance_and_closes_the_interfaces(system: MotionSystem) -> None:
    system.go(Behavior.STAND_MANIPULATE)
    system.lead(dict(zip(ARM, FORWARD, strict=True)), lambda s: s.joint_setpoint[ARM_PLACES[0]] < 0.1, "an arm moved")
    system.go(Behavior.SOFT_STOP)
    held = system.pass_time(1.0).joint_setpoint[ARM_PLACES]
    system.refused("soft_stop: attention is locked", setpoints={"neck_yaw": 0.1})
    system.refused("soft_stop: manipulation is locked", setpoints=dict(zip(ARM, FORWARD, strict=True)))
    assert np.allclose(system.pass_time(1.0).joint_setpoint[ARM_PLACES], held, atol=0.02)
    assert system.height > STANDING
    system.go(Behavior.STAND)
    system.pass_time(1.0)
    assert system.height > STANDING


@pytest.mark.parametrize("posture", [Behavior.STAND_PREP, Behavior.FREEZE])
def test_a_standing_robot_is_handed_to_its_servos_without_a_fall_and_back(
    system: MotionSystem, posture: Behavior
) -> None:
    height = system.pass_time(2.0).pelvis_position_in_odom[2]
    system.go(posture)
    begun = len(system.history)
    system.pass_time(0.3)
    lowest = min(state.pelvis_position_in_odom[2] for state in system.history[begun:])
    assert lowest > height - 0.01
    system.go(Behavior.STAND_PREP)
    system.stand()
    system.pass_time(1.0)
    assert system.height > STANDING


@pytest.mark.parametrize("name", ["motion_manager", "comms_manager"])
def test_a_process_that_stands_still_for_a_moment_is_no_fall(system: MotionSystem, name: str) -> None:
    system.pass_time(0.5)
    process = system.instance.process(name)
    process.send_signal(signal.SIGSTOP)
    try:
        time.sleep(0.3)  # the stall is the subject of this test
    finally:
        process.send_signal(signal.SIGCONT)
    system.pass_time(1.0)
    assert set(system.behaviors()) <= {"stand_prep", "stand"}
    assert system.height > STANDING


def test_proprioceptors_of_another_node_are_not_taken_for_the_robot(system: MotionSystem) -> None:
    recorded = PROPRIOCEPTOR.subscriber(system.instance.node("other"))
    said = wait_until(recorded.latest, 20.0, "a Proprioceptor").message
    replayed = PROPRIOCEPTOR.publisher(system.instance.node("player"))

    def play() -> bool:
        said.sequence, said.time, said.imu_orientation = 1, 1, np.array([0.0, 1.0, 0.0, 0.0])
        replayed.publish(said)
        system.look()
        return any("comes from player; expected comms_manager" in rejection.reason for rejection in system.rejections)

    wait_until(play, 20.0, "the replay refused")
    assert system.pass_time(1.0).behavior == Behavior.STAND
    assert system.height > STANDING


def test_who_floods_is_named_and_muted_while_the_motors_go_on(system: MotionSystem) -> None:
    """As many set-points as a loop can send; another sender leads the arm meanwhile."""
    system.go(Behavior.STAND_MANIPULATE)
    flooder = JOINT_SETPOINTS.publisher(system.instance.node("flooder"))
    nothing = np.zeros(1)
    stale = JointSetpoints(time=1, names=["neck_yaw"], position=nothing, velocity=nothing, acceleration=nothing)
    stop = threading.Event()

    def flood() -> None:
        while not stop.is_set():
            flooder.publish(stale)

    def named() -> bool:
        told = system._statistics.latest()
        return told is not None and told.message.state == "degraded" and FLOODED in told.message.detail

    thread = threading.Thread(target=flood)
    system.forget()
    thread.start()
    try:
        wait_until(named, 20.0, "the flooder is named")
        system.lead(
            dict(zip(ARM, FORWARD, strict=True)),
            lambda state: bool(np.allclose(state.joint_setpoint[ARM_PLACES], FORWARD, atol=0.05)),
            "the right arm forward, led by another",
        )
    finally:
        stop.set()
        thread.join()
    periods = np.diff([state.proprioceptor_sequence for state in system.history])
    assert periods.max() <= MISSED, f"{periods.max()} periods without a Motor"
    assert system.go(Behavior.STAND).behavior == Behavior.STAND
    assert system.height > STANDING


def test_pushed_over_the_robot_goes_limp_and_stays_fallen(system: MotionSystem) -> None:
    """The last in the shared system for which it stands."""
    system.pass_time(1.0)
    system.push((0.0, 80.0, 0.0))
    fallen = system.wait_behavior(Behavior.FALL)
    assert "limit" in fallen.reason
    system.pass_time(3.0)
    assert system.height < 0.5
    motor = wait_until(system.motors.latest, 10.0, "a Motor").message
    assert not motor.effort.any()
    assert not motor.stiffness.any()
    assert set(motor.mode) <= {JointMode.FORCE, JointMode.OFF}
    for behavior in ("stand", "stand_prep", "stand_manipulate", "idle"):
        assert not system.request(behavior).accepted
    assert "face-down only" in system.request("get_up").reason  # it fell on its side
    assert system.pass_time(0.1).reason == fallen.reason  # still the same
    # Lying on the floor it can be frozen and prepared, and never stands.
    system.go(Behavior.FREEZE)
    system.go(Behavior.STAND_PREP)

    def prepared() -> BehaviorReply | None:
        reply = system.request("stand")
        return None if any(word in reply.reason for word in ("to go", "begun", "silent")) else reply

    reply = wait_until(prepared, 60.0, "Stand Prep done", period=0.1)
    assert reply is not None
    assert not reply.accepted
    assert any(word in reply.reason for word in ("tilted", "foot", "above the soles", "settled")), reply.reason


def test_it_stops_at_once_when_told(started: MotionSystem) -> None:
    """The last one in the shared system."""
    assert started.instance.stop("motion_manager") == 0
    assert "Traceback" not in started.instance.log("motion_manager")
