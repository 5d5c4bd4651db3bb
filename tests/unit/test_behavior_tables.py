"""The behavior tables agree with each other, with the published figures and with the robots."""

import ast
import os
from collections import deque
from itertools import product
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.places import REPOSITORY, ROBOTS
from valor.common import behaviors
from valor.common.behaviors import BEHAVIOR_TRANSITIONS, INTERNAL_STATES, OPERATIONAL, Behavior, ControlMode, Locomotion
from valor.motion_manager.behavior_fsm import GUARDS, BehaviorFsm, Conditions, TransitionError
from valor.motion_manager.joints.joint_reference import JointReference
from valor.motion_manager.joints.upper_body import JOINT_ACCESS, SETPOINT_STATES, UpperBody, joint_owners
from valor.motion_manager.safety import DEMANDS, ENOUGH, RESUMED
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.control_modes import ControlModeTable

# Figure 3.8 of the thesis: rows from, columns to.
FIGURE_3_8 = """
                  idle stand_prep stand stand_manipulate step step_manipulate walk walk_manipulate soft_stop freeze fall get_up
idle              -    T          .     .                .    .               .    .               .         I      .    .
stand_prep        I    -          T     .                .    .               .    .               .         I      .    .
stand             .    P          -     T                P    .               P    .               T         I      T    .
stand_manipulate  .    .          T     -                I2   .               I2   .               T         I      T    .
step              .    .          P     .                -    T               .    .               T         .      T    .
step_manipulate   .    .          I2    .                T    -               .    .               T         .      T    .
walk              .    .          P     .                .    .               -    T               T         .      T    .
walk_manipulate   .    .          I2    .                .    .               T    -               T         .      T    .
soft_stop         .    .          I     .                .    .               .    .               -         I      I    .
freeze            I    P          .     .                .    .               .    .               .         -      I    .
fall              .    .          .     .                .    .               .    .               .         I      -    T
get_up            .    I          .     .                .    .               .    .               .         .      I    -
"""  # noqa: E501


def figure_3_8() -> dict[tuple[str, str], str]:
    header, *rows = (line.split() for line in FIGURE_3_8.strip().splitlines())
    return {(row[0], to): cell for row in rows for to, cell in zip(header, row[1:], strict=True)}


@pytest.mark.parametrize(("here", "there"), figure_3_8())
def test_transitions_of_the_thesis_are_those_of_the_figure(here: str, there: str) -> None:
    """Behaviors that the thesis lacks are free."""
    source = "-" if here == there else BEHAVIOR_TRANSITIONS[Behavior(here)].get(Behavior(there), ".")
    assert source == figure_3_8()[here, there]


def test_arms_are_open_only_in_manipulate_behaviors() -> None:
    for behavior, (_, manipulation, _) in INTERNAL_STATES.items():
        assert (manipulation is behaviors.Manipulation.TELEOP) == behavior.endswith("_manipulate")


def test_nobody_returns_to_operation_after_a_fall_but_through_stand_prep() -> None:
    paths = [[Behavior.FALL]]
    while paths:
        path = paths.pop()
        for there in BEHAVIOR_TRANSITIONS[path[-1]]:
            if there in OPERATIONAL:
                assert Behavior.STAND_PREP in path, " → ".join([*path, there])
            elif there not in path:
                paths.append([*path, there])


def test_no_joint_is_moved_by_two_state_machines() -> None:
    for (one, groups), (other, other_groups) in product(JOINT_ACCESS.items(), repeat=2):
        assert one is other or not set(groups) & set(other_groups)


def robots() -> list[str]:
    return sorted(folder.parent.name for folder in ROBOTS.glob("*/robot.yaml"))


@pytest.mark.parametrize("name", robots())
def test_every_joint_of_the_robot_is_moved_by_exactly_one_state_machine(name: str) -> None:
    robot = RobotDescription.load(ROBOTS / name)
    owners = joint_owners(robot)
    assert set(owners) == set(robot.joints)
    assert {owners[joint] for joint in robot.tables.groups["left_leg"]} == {Locomotion}
    assert {owners[joint] for joint in robot.tables.groups["right_arm"]} == {behaviors.Manipulation}
    assert {owners[joint] for joint in robot.tables.groups["neck"]} == {behaviors.Attention}
    assert Locomotion not in SETPOINT_STATES


def regrouped(groups: dict[str, list[str]]) -> RobotDescription:
    robot = RobotDescription.load(ROBOTS / "escher")
    return RobotDescription(robot.folder, msgspec.structs.replace(robot.tables, groups=robot.tables.groups | groups))


def test_a_joint_of_another_group_has_no_machine_and_stays_where_it_is() -> None:
    robot = regrouped({"neck": ["neck_yaw"], "tail": ["neck_pitch"]})
    assert set(robot.joints) - set(joint_owners(robot)) == {"neck_pitch"}
    upper_body = UpperBody(robot, JointReference(robot))
    assert not any(joints[robot.index["neck_pitch"]] for joints in upper_body.joints.values())


# Behaviors and control modes are spelled in one place, and every table that goes by them knows all of them.
MODES = ControlModeTable.load()
HOME = REPOSITORY / "valor" / "common" / "behaviors.py"
VERBS = REPOSITORY / "valor/valorctl/terminal/app.py"  # verbs of the command line, such as walk
EVERYDAY_WORDS = {"none", "idle", "stop", "step"}  # and of a plan, a verb, a clock, an option


def product_files() -> list[Path]:
    return [
        Path(folder) / name
        for root in ("bifrost", "services", "thesis", "valor")
        for folder, _, names in os.walk(REPOSITORY / root)
        for name in names
        if name.endswith(".py")
    ]


def test_names_are_spelled_in_one_module() -> None:
    names = {*Behavior, *ControlMode} - EVERYDAY_WORDS
    spelled = [
        f"{file.relative_to(REPOSITORY)}:{node.lineno}: {node.value!r}"
        for file in product_files()
        if file not in (HOME, VERBS)
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value in names
    ]
    assert not spelled


@pytest.mark.parametrize("behavior", Behavior)
def test_every_table_has_every_behavior(behavior: Behavior) -> None:
    assert behavior in INTERNAL_STATES and behavior in BEHAVIOR_TRANSITIONS and behavior in MODES.behaviors
    assert behavior in RESUMED


@pytest.mark.parametrize("behavior", Behavior)
@pytest.mark.parametrize("demand", DEMANDS)
def test_devices_that_fail_are_answered_in_every_behavior(demand: behaviors.Reaction, behavior: Behavior) -> None:
    edges = BEHAVIOR_TRANSITIONS[behavior]
    assert behavior in ENOUGH[demand] or any(wanted is behavior or wanted in edges for wanted in DEMANDS[demand])


def test_control_modes_are_the_rows_of_their_table() -> None:
    assert list(MODES.modes) == list(ControlMode)


@pytest.mark.parametrize("behavior", Behavior)
def test_what_is_true_of_a_behavior_follows_from_its_internal_states(behavior: Behavior) -> None:
    assert behavior.operational <= behavior.balancing and behavior.manipulating <= behavior.operational
    assert not (behavior.fallen and (behavior.balancing or behavior.stopped))
    assert (behavior in behaviors.STEPPING | behaviors.WALKING) is behavior.locomotion.stepping
    assert behavior.manipulating is behavior.endswith("_manipulate")


@examples(100)
@given(st.text(min_size=1))
def test_the_requester_of_a_change_is_read_from_its_reason(text: str) -> None:
    assert behaviors.requester(behaviors.requested_by(text)) == text and behaviors.requester(f" {text}") == ""


# The Behavior FSM: every request and every change in every behavior.
FINE = Conditions()


def path_to(target: Behavior) -> list[Behavior]:
    """The shortest way from Idle."""
    paths = deque([[Behavior.IDLE]])
    while paths[0][-1] is not target:
        path = paths.popleft()
        paths += [[*path, there] for there in BEHAVIOR_TRANSITIONS[path[-1]] if there not in path]
    return paths[0]


def machine_in(behavior: Behavior) -> BehaviorFsm:
    fsm = BehaviorFsm()
    for step in path_to(behavior)[1:]:
        fsm.go(step, "test")
    assert fsm.behavior is behavior
    return fsm


@pytest.mark.parametrize(("here", "there"), list(product(Behavior, Behavior)))
def test_every_request_and_every_change_in_every_behavior(here: Behavior, there: Behavior) -> None:
    fsm = machine_in(here)
    if there is not here and there not in BEHAVIOR_TRANSITIONS[here]:
        with pytest.raises(TransitionError, match=f"no transition from {here} to {there}"):
            fsm.go(there, "something happened")
        assert fsm.behavior is here
    before = fsm.reason, fsm.changes
    verdict = fsm.request(there, FINE, "somebody")
    by_itself = (here, there) == (Behavior.GET_UP, Behavior.STAND_PREP)
    if by_itself:
        assert (verdict.accepted, verdict.reason) == (False, "the robot has not finished getting up")
        return
    allowed = there is here or there in BEHAVIOR_TRANSITIONS[here]
    assert verdict.accepted == allowed
    assert fsm.behavior is (there if allowed else here)
    assert (fsm.locomotion, fsm.manipulation, fsm.attention) == INTERNAL_STATES[fsm.behavior]
    if there is here:
        assert "already" in verdict.reason
        assert (fsm.reason, fsm.changes) == before
    elif allowed:
        assert fsm.reason == "requested by somebody" and fsm.changes == before[1] + 1
    else:
        assert f"no transition from {here} to {there}" in verdict.reason
        assert (fsm.reason, fsm.changes) == before


@pytest.mark.parametrize("flaw", ["not_prepared", "not_loaded", "not_upright"])
def test_stand_is_refused_from_stand_prep_for_each_flaw(flaw: str) -> None:
    fsm = machine_in(Behavior.STAND_PREP)
    verdict = fsm.request(Behavior.STAND, Conditions(**{flaw: "because of the test"}), "somebody")
    assert (verdict.accepted, verdict.reason) == (False, "because of the test")
    assert fsm.behavior is Behavior.STAND_PREP and fsm.request(Behavior.STAND, FINE, "somebody").accepted


def test_no_operational_behavior_is_entered_from_outside_without_a_guard() -> None:
    for here, row in BEHAVIOR_TRANSITIONS.items():
        for there in row:
            if there in OPERATIONAL and here not in OPERATIONAL and here is not Behavior.SOFT_STOP:
                assert GUARDS[here, there]
