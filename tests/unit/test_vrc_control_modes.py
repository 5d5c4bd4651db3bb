"""The table of control modes agrees with ViGIR's messages, with the Motion System and with the documentation."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from harness.places import REPOSITORY
from valor.common.behaviors import BEHAVIOR_TRANSITIONS, EMERGENCY_STOP, INTERNAL_STATES, Behavior
from valor.common.errors import ConfigurationError
from valor.common.messages import ModeStatus
from valor.robot.description import RobotDescription
from valor.valor_ros_controller.control_modes import FILE, ControlModeTable
from valor.valor_ros_controller.controllers.configuration import TrackingControllerConfig, TrajectoryControllerConfig
from valor.valor_ros_controller.controllers.table import ControllersTable
from valor.valor_ros_controller.trajectory.waypoints import ErrorCode
from valor.valor_ros_controller.valor_escher_hw_interface import ValorEscherHWInterface

TABLE = ControlModeTable.load()
CONTROLLERS = ControllersTable.load()
GOALS = CONTROLLERS.of_type(TrajectoryControllerConfig)

# Boston Dynamics' ids and upper-body flags as Team ViGIR's Atlas table binds them.
BDI = {
    "none": (1, 0), "stop": (-1, -1), "freeze": (1, 0), "stand_prep": (2, 0), "stand": (3, 0), "walk": (4, 0),
    "step": (5, 0), "manipulate": (6, -1), "soft_stop": (9, 0), "stand_manipulate": (3, 1), "walk_manipulate": (4, 1),
    "step_manipulate": (5, 1),
}  # fmt: skip


def reachable(start: str, command: str) -> bool:
    return start == command or Behavior(command) in BEHAVIOR_TRANSITIONS[Behavior(start)]


def test_modes_and_bdi_columns_are_vigirs() -> None:
    assert {name: (mode.bdi, mode.upper_body) for name, mode in TABLE.modes.items()} == BDI


def test_behaviors_are_those_of_the_motion_system() -> None:
    assert set(TABLE.behaviors) == {behavior.value for behavior in Behavior}


@pytest.mark.parametrize("name", TABLE.modes)
def test_two_commands_lead_from_every_mode_to_each_that_may_follow(name: str) -> None:
    mode = TABLE.modes[name]
    for follower in mode.to:
        pair = TABLE.modes[follower].motion
        if pair is None:
            continue
        if mode.motion is not None:
            # Where the mode was asked for, and where it is only what the Motion System is in.
            starts = {mode.motion[1]} | {b for b, m in TABLE.behaviors.items() if m == name and b != "get_up"}
        else:
            starts = {"stand"}
        if name == "none":
            # Idle, Freeze and Fall are all none; only from some of them is there a way, and the Manager says which.
            assert any(reachable(start, pair[0]) for start in starts), follower
        else:
            assert all(reachable(start, pair[0]) for start in starts), follower
        assert reachable(*pair), follower


def test_controllers_of_a_mode_are_accepted_by_its_behavior() -> None:
    for name, mode in TABLE.modes.items():
        if mode.motion is None:
            continue
        locomotion, manipulation, attention = INTERNAL_STATES[Behavior(mode.motion[1])]
        states: dict[str, str] = {"locomotion": locomotion, "manipulation": manipulation, "attention": attention}
        states |= dict.fromkeys(("left_arm", "right_arm"), "setpoints" if manipulation == "teleop" else "nobody")
        accepted = {
            controller
            for controller, config in GOALS.items()
            if controller in CONTROLLERS.joint_controllers
            and all(states[machine] == state for machine, state in config.accepted_when.items())
        }
        assert set(mode.joint_controllers) == accepted | set(CONTROLLERS.of_type(TrackingControllerConfig)), name
        for controller in set(mode.robot_controllers) & set(GOALS):
            config = GOALS[controller]
            assert all(states[machine] == state for machine, state in config.accepted_when.items()), name


def test_a_reported_behavior_has_a_mode_that_stands_for_it() -> None:
    for behavior, mode in TABLE.behaviors.items():
        assert TABLE.fits(mode, behavior)
    assert TABLE.behaviors["fall"] == "none"


def test_an_emergency_stop_is_possible_in_every_mode_but_after_a_stop_of_its_own() -> None:
    for name, mode in TABLE.modes.items():
        choices = [stop for stop in TABLE.emergency_stop if stop == name or stop in mode.to]
        assert choices, name
        walks = mode.motion is not None and mode.motion[0] in ("step", "walk")
        assert not walks or choices[0] == "soft_stop", "a robot that locks its joints in single support topples"


def test_flags_and_codes_are_those_of_the_messages() -> None:
    from control_msgs.action import FollowJointTrajectory
    from vigir_humanoid_control_msgs.msg import ControlModeStatus, VigirControlModeCommand

    for flag in ModeStatus.__members__:
        assert int(ModeStatus[flag]) == getattr(ControlModeStatus, flag)
    for code in ErrorCode:
        assert int(code) == getattr(FollowJointTrajectory.Result, code.name)
    assert VigirControlModeCommand.EMERGENCY_STOP == EMERGENCY_STOP


@pytest.mark.parametrize("robot", [path.parent.name for path in (REPOSITORY / "robots").glob("*/robot.yaml")])
def test_controllers_find_their_joints_in_every_robot(robot: str) -> None:
    description = RobotDescription.load(REPOSITORY / "robots" / robot)
    hw = ValorEscherHWInterface(description)
    for name, config in CONTROLLERS.all.items():
        assert not config.groups or hw.group_indices(config.groups).size, name


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        (("modes", "stand", "to"), ["fly"], ("modes.stand", "fly")),
        (("modes", "stand", "motion"), ["hover", "hover"], ("modes.stand", "hover")),
        (("modes", "stand", "switch"), "slowly", ("modes.stand.switch",)),
        (("modes", "stand", "colour"), "red", ("modes.stand.colour",)),
        (("behaviors", "fall"), "lost", ("behaviors", "lost")),
        (("emergency_stop",), ["freeze", "brake"], ("emergency_stop", "brake")),
    ],
)
def test_a_wrong_table_is_refused_with_file_and_key(tmp_path: Path, key: str, value: Any, words: str) -> None:
    content = yaml.safe_load(FILE.read_text())
    place = content
    for part in key[:-1]:
        place = place[part]
    place[key[-1]] = value
    file = tmp_path / "modes.yaml"
    file.write_text(yaml.safe_dump(content))
    with pytest.raises(ConfigurationError) as error:
        ControlModeTable.load(file)
    for word in (str(file), *words):
        assert word in str(error.value)
    assert "\n" not in str(error.value)
