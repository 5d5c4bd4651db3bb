"""Motion Manager and Comms Manager killed, stopped and started again under a robot: nothing moves until commanded."""

import signal
from collections.abc import Callable

import numpy as np
import pytest

from bifrost import Subscriber
from harness.instance import RunningInstance
from harness.places import ROBOTS
from harness.waiting import wait_until
from tests.integration.motion_system import STANDING, MotionSystem
from valor.common.behaviors import REFLEX, Behavior
from valor.common.messages import BehaviorReply, BehaviorRequest, Proprioceptor
from valor.common.topics import PROPRIOCEPTOR, STATISTICS, STOP
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


@pytest.fixture(scope="module")
def started(module_instance: RunningInstance) -> MotionSystem:
    """One system for all tests, in real time: the robot lives on while the Motion Manager starts."""
    module_instance.configure(real_time_factor=1.0, actuators="hardware")
    return MotionSystem(module_instance)


@pytest.fixture
def system(started: MotionSystem) -> MotionSystem:
    """The system; its robot stands."""
    started.stand()
    started.forget()
    return started


def test_a_comms_manager_killed_in_stand_prep_moves_nothing_until_commanded(started: MotionSystem) -> None:
    system, instance = started, started.instance
    system.pass_time(0.5)
    instance.kill("comms_manager")
    wait_until(lambda: "silent" in system.request("get_up").reason, 20.0, "requests answered: no robot")
    instance.start("comms_manager")
    assert "another world" in system.wait_behavior(Behavior.FREEZE).reason
    system.stand()
    system.pass_time(0.5)
    assert system.height > STANDING


def test_a_killed_comms_manager_is_a_fall_with_its_reason(system: MotionSystem) -> None:
    system.instance.kill("comms_manager")
    system.instance.start("comms_manager")
    assert "another world" in system.wait_behavior(Behavior.FALL).reason and not system.request("stand").accepted


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


def test_whoever_is_killed_no_joint_moves_until_somebody_commands_it(system: MotionSystem) -> None:
    """Frozen with an arm up, standing, and fallen: one robot, whose Motion Manager dies again and again."""
    system.go(Behavior.STAND_MANIPULATE)
    up = dict(zip(ARM, FORWARD, strict=True))
    system.lead(up, lambda state: bool(np.allclose(state.joint_setpoint[ARM_PLACES], FORWARD, atol=0.05)), "an arm up")
    system.go(Behavior.FREEZE)
    system.pass_time(1.0)  # the arm comes to rest
    for _ in range(2):
        assert moved(killed_and_back(system)) < HELD
        assert "before, the robot was in freeze" in system.wait_behavior(Behavior.FREEZE).reason
    system.stand()
    assert moved(killed_and_back(system)) < HELD
    assert "before, the robot was in stand" in system.wait_behavior(Behavior.FREEZE).reason
    assert system.height > STANDING
    system.stand()

    system.push((0.0, 80.0, 0.0))
    system.wait_behavior(Behavior.FALL)
    system.pass_time(3.0)
    limp = killed_and_back(system)
    assert "before, the robot was in fall" in system.wait_behavior(Behavior.FALL).reason and system.height < 0.5
    assert driven(limp) < DRIVEN
    assert "stay limp" in system.instance.log("comms_manager")


def last_led_by(measured: Subscriber[Proprioceptor]) -> str:
    """The behavior of the Motor in force."""
    return wait_until(measured.latest, 20.0, "a Proprioceptor").message.motor_behavior


def let_go_by_the_reflex(system: MotionSystem, measured: Subscriber[Proprioceptor]) -> None:
    """Whoever wants it limp while nobody but the reflex is there has it limp."""
    instance = system.instance
    system.stand()
    system.walk_on_one_foot(1.0)
    instance.kill("motion_manager")
    wait_until(lambda: last_led_by(measured) == REFLEX, 30.0, "the reflex")
    reply = (
        instance.node("somebody")
        .client(STOP.name, BehaviorRequest, BehaviorReply)
        .call(BehaviorRequest("fall"), timeout=10.0)
    )
    assert (reply.accepted, reply.behavior) == (True, "fall")
    wait_until(lambda: last_led_by(measured) == "fall", 30.0, "what was asked for")
    sinking = [wait_until(measured.latest, 20.0, "a Proprioceptor").message for _ in range(10)]
    assert {each.motor_behavior for each in sinking} == {"fall"} and driven(sinking[5:]) < FALLING
    instance.start("motion_manager", wait=True)
    assert "before, the robot was in fall" in system.wait_behavior(Behavior.FALL).reason


def test_whoever_is_killed_or_stopped_in_the_middle_of_a_step_the_robot_comes_to_stand(system: MotionSystem) -> None:
    instance = system.instance
    witness = instance.node("witness")
    measured = PROPRIOCEPTOR.subscriber(witness)
    statistics = STATISTICS["comms_manager"].subscriber(witness)

    def rejected() -> int:
        statistics.latest()
        return wait_until(statistics.latest, 20.0, "new statistics").message.rejected

    def stopped_and_continued() -> None:
        process = system.instance.process("motion_manager")
        process.send_signal(signal.SIGSTOP)
        try:
            wait_until(lambda: last_led_by(measured) == REFLEX, 30.0, "the reflex")
            wait_until(lambda: last_led_by(measured) == "walk", 30.0, "its end")
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
        system.stand()
        system.walk_on_one_foot(3.0)
        what()
        reason = system.wait_behavior(Behavior.FREEZE).reason
        assert any(expected in reason for expected in reasons), reason
        assert system.pass_time(1.0).behavior == Behavior.FREEZE and system.height > STANDING
    assert "it stands, after" in instance.log("comms_manager")

    let_go_by_the_reflex(system, measured)


def test_both_managers_killed_the_robot_is_not_brought_to_its_feet(system: MotionSystem) -> None:
    """The simulated one begins in the air, as a robot that was lifted meanwhile: it is not known to stand."""
    instance = system.instance
    instance.kill("motion_manager")
    instance.kill("comms_manager")
    instance.start("comms_manager")
    instance.start("motion_manager", wait=True)
    assert "before, the robot was in stand; the left foot carries" in system.wait_behavior(Behavior.FALL).reason
    assert "stand_prep" not in system.behaviors()[-2:]
