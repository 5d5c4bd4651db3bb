"""The behavior tables agree with each other, with the published figures and with the robots."""

from __future__ import annotations

from itertools import product

import msgspec
import pytest

from harness.places import ROBOTS
from valor.common.behaviors import INTERNAL_STATES, OPERATIONAL, Attention, Behavior, Locomotion, Manipulation
from valor.motion_manager.joints.joint_reference import JointReference
from valor.motion_manager.joints.upper_body import UpperBody
from valor.motion_manager.states.transitions import (
    ATTENTION_TRANSITIONS,
    BEHAVIOR_TRANSITIONS,
    JOINT_ACCESS,
    LOCOMOTION_TRANSITIONS,
    MANIPULATION_TRANSITIONS,
    SETPOINT_STATES,
    joint_owners,
)
from valor.robot.description import RobotDescription

# Figure 3.8 as it stands in the reconstruction, typed here once more: rows from, columns to.
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


@pytest.mark.parametrize(("here", "there"), list(product(Behavior, Behavior)))
def test_every_pair_of_behaviors_is_as_in_the_figure(here: Behavior, there: Behavior) -> None:
    cell = figure_3_8()[here, there]
    if here is there:
        assert cell == "-"
        assert there not in BEHAVIOR_TRANSITIONS[here]
    else:
        assert BEHAVIOR_TRANSITIONS[here].get(there, ".") == cell


def test_every_state_has_a_row() -> None:
    assert set(BEHAVIOR_TRANSITIONS) == set(INTERNAL_STATES) == set(Behavior)
    assert set(LOCOMOTION_TRANSITIONS) == set(Locomotion)
    assert set(MANIPULATION_TRANSITIONS) == set(Manipulation)
    assert set(ATTENTION_TRANSITIONS) == set(Attention)


@pytest.mark.parametrize(
    ("here", "there"), [(here, there) for here, row in BEHAVIOR_TRANSITIONS.items() for there in row]
)
def test_an_edge_of_the_behavior_fsm_is_an_edge_of_each_internal_fsm(here: Behavior, there: Behavior) -> None:
    tables = (LOCOMOTION_TRANSITIONS, MANIPULATION_TRANSITIONS, ATTENTION_TRANSITIONS)
    for table, before, after in zip(tables, INTERNAL_STATES[here], INTERNAL_STATES[there], strict=True):
        assert after is before or after in table[before]  # type: ignore[index]


def test_every_edge_of_locomotion_is_used_by_a_behavior() -> None:
    used = {
        (INTERNAL_STATES[here][0], INTERNAL_STATES[there][0])
        for here, row in BEHAVIOR_TRANSITIONS.items()
        for there in row
    }
    edges = {(here, there) for here, row in LOCOMOTION_TRANSITIONS.items() for there in row}
    assert edges == {(here, there) for here, there in used if here is not there}


def test_a_manipulate_behavior_is_entered_only_from_its_base() -> None:
    for target in Behavior:
        if target.endswith("_manipulate"):
            base = Behavior(target.removesuffix("_manipulate"))
            assert [here for here, row in BEHAVIOR_TRANSITIONS.items() if target in row] == [base]


def test_arms_are_open_only_in_manipulate_behaviors() -> None:
    for behavior, (_, manipulation, _) in INTERNAL_STATES.items():
        assert (manipulation is Manipulation.TELEOP) == behavior.endswith("_manipulate")


def test_from_operational_behaviors_the_robot_can_fall_and_soft_stop() -> None:
    for behavior in OPERATIONAL:
        assert {Behavior.FALL, Behavior.SOFT_STOP} <= set(BEHAVIOR_TRANSITIONS[behavior])


def test_every_behavior_can_be_reached_from_idle() -> None:
    reached, frontier = {Behavior.IDLE}, [Behavior.IDLE]
    while frontier:
        new = set(BEHAVIOR_TRANSITIONS[frontier.pop()]) - reached
        reached |= new
        frontier += new
    assert reached == set(Behavior)


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
    assert {owners[joint] for joint in robot.tables.groups["right_arm"]} == {Manipulation}
    assert {owners[joint] for joint in robot.tables.groups["neck"]} == {Attention}
    assert Locomotion not in SETPOINT_STATES


def regrouped(groups: dict[str, list[str]]) -> RobotDescription:
    robot = RobotDescription.load(ROBOTS / "escher")
    return RobotDescription(robot.folder, msgspec.structs.replace(robot.tables, groups=robot.tables.groups | groups))


def test_a_joint_of_another_group_has_no_machine_and_stays_where_it_is() -> None:
    robot = regrouped({"neck": ["neck_yaw"], "tail": ["neck_pitch"]})
    assert set(robot.joints) - set(joint_owners(robot)) == {"neck_pitch"}
    upper_body = UpperBody(robot, JointReference(robot))
    assert not any(joints[robot.index["neck_pitch"]] for joints in upper_body.joints.values())
