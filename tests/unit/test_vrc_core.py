"""The VRC's small parts against what they stand for: interfaces' numbers, derivatives, shapes, ages, answers."""

from __future__ import annotations

import threading
from collections import Counter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import bifrost
from harness.examples import examples
from harness.instance import RunningInstance
from harness.places import ROBOTS
from harness.vrc_in_process import SILENCE, System
from harness.waiting import wait_until
from tests.unit.test_robot_urdf import NAMES
from tests.unit.test_vrc_joint_trajectory_controller import PERIOD, Arm, point
from tests.unit.test_vrc_trajectory import LIMITS, NOW
from valor.common import topics
from valor.common.messages import BehaviorReply, BehaviorRequest, ClockStatus, MotionState
from valor.common.topics import BEHAVIOR, STOP, ServiceTopic
from valor.robot.commanded_limits import CommandedLimits
from valor.robot.description import RobotDescription
from valor.robot.model import full_model
from valor.robot.model_tree import read
from valor.valor_ros_controller.behavior_transition import BehaviorAnswer
from valor.valor_ros_controller.trajectory.admission import begin, check_waypoints
from valor.valor_ros_controller.trajectory.waypoints import InvalidTrajectoryError, Point
from valor.valor_ros_controller.valor_escher_interface import BehaviorCommander

SECOND = 1_000_000_000
THREE = ("shoulder", "elbow", "wrist")


INF = np.full(3, np.inf)
FREE = CommandedLimits(THREE, ("rad",) * 3, -INF, INF, velocity=np.full(3, 1e3), acceleration=INF, effort=INF)
place = st.floats(-0.4, 0.4)
vector = st.tuples(place, place, place)


@examples(30)
@given(st.sampled_from([1, 2, 3]), st.lists(st.tuples(vector, vector, vector), min_size=1, max_size=3))
def test_velocity_and_acceleration_are_the_derivatives_of_position(order: int, states: list[Any]) -> None:
    """Of splines of every order, within every segment."""
    states[-1] = (states[-1][0], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    points = []
    for k, state in enumerate(states):
        position, velocity, acceleration = (list(part) if i < order else [] for i, part in enumerate(state))
        points.append(Point(position, velocity, acceleration, [], 3.0 * (k + 1)))
    rest = np.zeros((3, 3))
    trajectory = begin(check_waypoints(THREE, points, FREE), 0, NOW, rest, FREE, since=NOW)
    step = SECOND // 1000
    for at in (0.3, 1.1, 2.7, 3.5, 5.2, 8.4):
        time = NOW + round(at * SECOND)
        if time + step >= trajectory.end:
            break
        before, here, after = (trajectory.at(time + shift) for shift in (-step, 0, step))
        for rate, value in ((here[1], 0), (here[2], 1)):
            np.testing.assert_allclose(rate, (after[value] - before[value]) / 2e-3, atol=2e-4)


def part(kind: str, shape: str, size: Any, position: Any, rotation: Any, color: Any) -> tuple[Any, ...]:
    """One shape of a link, to be compared; how a ball is turned does not matter, nor the colour of what is not seen."""
    numbers = (size, position, () if shape == "sphere" else rotation, color if kind == "visual" else ())
    return kind, shape, *(tuple(np.round(np.ravel(each).astype(float), 5) + 0.0) for each in numbers)


def modelled(mj: mujoco.MjModel, body: str) -> Counter[tuple[Any, ...]]:
    """What the model gives a body. A capsule is a cylinder with two balls."""
    found: Counter[tuple[Any, ...]] = Counter()
    for geom in np.flatnonzero(mj.geom_bodyid == mj.body(body).id).tolist():
        shape, size, position = (
            mujoco.mjtGeom(mj.geom_type[geom]).name[7:].lower(),
            mj.geom_size[geom],
            mj.geom_pos[geom],
        )
        rotation = Rotation.from_quat(mj.geom_quat[geom], scalar_first=True).as_matrix()
        color = mj.geom_rgba[geom] if mj.geom_matid[geom] < 0 else mj.mat_rgba[mj.geom_matid[geom]]
        kind = "collision" if mj.geom_group[geom] == 3 else "visual"
        if shape == "capsule":
            for end in (-size[1], size[1]):
                found[part(kind, "sphere", size[0], position + end * rotation[:, 2], rotation, color)] += 1
        if shape in ("box", "sphere", "cylinder", "capsule"):
            known = {"box": 2.0 * size, "sphere": size[:1]}.get(shape, np.array((size[0], 2.0 * size[1])))
            found[part(kind, shape.replace("capsule", "cylinder"), known, position, rotation, color)] += 1
    return found


def described(link: ElementTree.Element) -> Counter[tuple[Any, ...]]:
    """What the URDF gives a link."""

    def numbers(element: ElementTree.Element | None, key: str) -> list[float]:
        return [] if element is None else [float(each) for each in element.get(key, "").split()]

    found: Counter[tuple[Any, ...]] = Counter()
    for kind in ("collision", "visual"):
        for each in link.findall(kind):
            (shape,), origin = each.findall("geometry/*"), each.find("origin")
            size = [number for key in ("size", "radius", "length") for number in numbers(shape, key)]
            rotation = Rotation.from_euler("xyz", numbers(origin, "rpy")).as_matrix()
            color = numbers(each.find("material/color"), "rgba")
            assert bool(color) == (kind == "visual")
            found[part(kind, shape.tag, size, numbers(origin, "xyz"), rotation, color)] += 1
    return found


@pytest.mark.parametrize("name", NAMES)
def test_links_have_the_shapes_and_colours_of_the_model(name: str, tmp_path: Path) -> None:
    """With one more of each kind on a hand, for no robot has them all."""
    original = ROBOTS / name
    (tmp_path / "robot.yaml").write_text((original / "robot.yaml").read_text())
    added = (("sphere", ".02"), ("cylinder", ".02 .05"), ("capsule", ".03 .04"), ("box", ".01 .02 .03"))
    more = "".join(
        f'<geom type="{kind}" size="{size}" pos="0.01 0.02 0.03" euler="0.2 0.4 0.6" rgba="0.1 0.{i} 0 1" mass="0"/>'
        for i, (kind, size) in enumerate(added)
    )
    model = (original / "model.xml").read_text()
    site = model.index("<site", model.index('name="l_wrist_yaw"'))
    (tmp_path / "model.xml").write_text(model[:site] + more + model[site:])
    robot = RobotDescription.load(tmp_path)
    tree = read(robot)
    mj = full_model(robot, "all").mj
    links = {link.get("name"): link for link in ElementTree.fromstring(tree.urdf).iter("link")}
    everything: Counter[tuple[Any, ...]] = Counter()
    for name in [tree.base, *(link.name for link in tree.links)]:
        assert described(links[name]) == modelled(mj, name), name
        everything += modelled(mj, name)
    assert {(kind, shape) for kind, shape, *_ in everything} >= {
        ("collision", "cylinder"), ("visual", "box"), ("visual", "cylinder"), ("visual", "sphere"),
    }  # fmt: skip


@pytest.fixture
def system() -> System:
    made = System()
    made.run(4)
    return made


def test_the_pelvis_velocity_is_how_fast_the_pelvis_moves_in_robot_time(system: System) -> None:
    interface, hw = system.vrc.interface, system.vrc.hw
    newest = hw.motion
    assert newest is not None
    rate = np.array([0.2, -0.1, 0.05, 0.3, -0.2, 0.1])
    for period in range(1, 400):
        time = newest.time + period * 2_000_000
        changes = {"time": time, "pelvis_in_support": rate * period * 0.002}
        content = {name: getattr(newest, name) for name in MotionState.__struct_fields__} | changes
        interface._motion_state.publish(MotionState(**content))  # type: ignore[attr-defined]
        interface.poll()
    np.testing.assert_allclose(hw.velocity[hw.pelvis :], rate, rtol=0.02)
    np.testing.assert_allclose(hw.position[hw.pelvis :], rate * 399 * 0.002)


def test_cycles_that_come_late_are_counted_and_another_robot_time_is_not(system: System) -> None:
    interface = system.vrc.interface
    system.run(10)
    late = interface.late
    system.vrc_late = True
    system.run(20)
    system.vrc_late = False
    system.run(10)
    assert interface.late == late + 1 and interface.longest_gap >= 20
    interface.longest_gap = 0
    system.restart_comms_manager()
    system.run(10)
    assert interface.late == late + 1 and interface.longest_gap <= 3


def test_a_trajectory_of_another_clock_is_refused_with_both_times() -> None:
    points = check_waypoints(THREE, [Point([0.1] * 3, [], [], [], 1.0)], LIMITS)
    rest = np.zeros((3, 3))
    with pytest.raises(InvalidTrajectoryError, match=r"begins 3600 s after now \(5\.000 s of robot time\)"):
        begin(points, NOW + 3600 * SECOND, NOW, rest, LIMITS, since=NOW)
    assert begin(points, NOW + 300 * SECOND, NOW, rest, LIMITS, since=NOW).end == NOW + 301 * SECOND


def test_asked_beyond_a_trajectory_the_arm_says_by_how_much() -> None:
    arm = Arm().start()
    asked = arm.hw.time
    arm.request([point(1.0, 0.2)])
    arm.run(2 * PERIOD / SECOND)
    begun, ended = arm.controller._trajectory.start, arm.controller._trajectory.end
    assert begun >= asked
    assert "0.250 s before the trajectory begins" in arm.controller.state_at(begun - SECOND // 4)[0]
    assert "1.500 s after the trajectory has ended" in arm.controller.state_at(ended + 3 * SECOND // 2)[0]
    for inside in (begun, (begun + ended) // 2, ended):
        assert arm.controller.state_at(inside)[0] == ""


def test_the_commander_asks_for_the_newest_and_for_nothing_that_was_forgotten(instance: RunningInstance) -> None:
    asked: list[str] = []

    def serve(request: BehaviorRequest, origin: str) -> BehaviorReply:
        asked.append(request.behavior)
        return BehaviorReply(accepted=request.behavior == "stand", behavior="stand_prep", reason="because", obstacle="")

    manager = instance.node("motion_manager")
    server = BEHAVIOR.server(manager, serve)
    heard = threading.Event()
    commander = BehaviorCommander(instance.node("valor_ros_controller"), heard.set)

    def ask(number: int, behavior: str) -> BehaviorAnswer | None:
        """What came of it; None: the Motion Manager has not been found yet."""
        commander.request(number, behavior)
        while (answer := commander.answers.read()) is None or answer.number != number:
            server.serve()
            heard.wait(0.01)
        return None if answer.silent else answer

    try:
        for number, behavior, accepted in ((2, "stand", True), (3, "walk", False)):
            answer = wait_until(lambda n=number, b=behavior: ask(n, b), 30.0, f"the answer to {behavior}")  # type: ignore[misc]
            assert (answer.number, answer.accepted, answer.behavior) == (number, accepted, "stand_prep")
            assert accepted or "rejected walk: because" in answer.reason
            commander.request(0, "step")  # not served yet, so that the next one waits
            commander.request(1, "idle")
            commander.discard()
        assert "idle" not in asked and asked == sorted(asked)
    finally:
        commander.close()


def test_a_stop_goes_to_the_comms_manager_where_there_is_no_motion_manager(instance: RunningInstance) -> None:
    asked: list[tuple[str, str]] = []

    def server_of(name: str, topic: ServiceTopic[Any, Any]) -> bifrost.Server[BehaviorRequest, BehaviorReply]:
        def serve(request: BehaviorRequest, _origin: str) -> BehaviorReply:
            asked.append((name, request.behavior))
            return BehaviorReply(accepted=False, behavior="fall", reason="it lies", obstacle="condition")

        return topic.server(instance.node(name), serve)

    servers = [server_of("comms_manager", STOP)]
    heard = threading.Event()
    commander = BehaviorCommander(instance.node("valor_ros_controller"), heard.set)

    def ask(behavior: str) -> str:
        heard.clear()
        commander.request(1, behavior)
        while not heard.wait(0.01):
            for server in servers:
                server.serve()
        answer = commander.answers.read()
        assert answer is not None
        return "" if answer.silent else answer.reason

    try:
        for behavior in ("freeze", "soft_stop"):
            reason = wait_until(lambda b=behavior: ask(b), 30.0, f"the answer to {behavior}")  # type: ignore[misc]
            assert reason == f"the Comms Manager rejected {behavior}: it lies"
        assert not ask("stand"), "nobody stands a robot up but the Motion Manager"
        assert asked == [("comms_manager", "freeze"), ("comms_manager", "soft_stop")]
        servers.append(server_of("motion_manager", BEHAVIOR))
        wait_until(lambda: ask("stand"), 30.0, "the Motion Manager's answer")
        assert ask("freeze") == "the Motion Manager rejected freeze: it lies"
        assert ("comms_manager", "stand") not in asked
    finally:
        commander.close()


def silence(system: System) -> str:
    """Whom the VRC names after nothing has come for too long."""
    system.clock += 2.0 * SILENCE
    system.vrc.interface.receive(0.0)
    system.vrc.interface.poll()
    return system.vrc.interface.silent


def test_a_comms_manager_that_got_its_motor_is_named(system: System) -> None:
    """In lockstep, one's end silences the other."""
    assert system.vrc.interface.silent == ""
    assert silence(system) == "comms_manager"


def test_a_comms_manager_that_died_before_its_last_word_had_reached_everybody_is_named(system: System) -> None:
    """The Motion Manager seemed to owe a Motor to a Proprioceptor that the VRC alone had got."""
    system.frozen = True
    system.run(2)
    assert silence(system) == "motion_manager"  # as long as it is not known to be gone
    system.network.topic(topics.PROPRIOCEPTOR.name).publishers = ()
    assert silence(system) == "comms_manager"


def test_while_time_is_paused_nobody_is_named_and_afterwards_whoever_is(system: System) -> None:
    clock = system.network.topic(topics.CLOCK.name)

    def said(mode: str) -> None:
        clock.publish(ClockStatus(mode, 0, 0.0, 0.0, 0, False))

    for _ in range(5):
        said(topics.PAUSED)
        assert silence(system) == ""
    said("lockstep")
    assert silence(system) == "comms_manager"
    said(topics.PAUSED)
    assert silence(system) == "comms_manager", "who was silent before is no pause's"
