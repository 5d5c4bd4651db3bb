"""A robot may lack head, hands, arms and waist: it stands and walks, and is refused what it has not the limbs for."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from bifrost import Received
from harness.closed_loop import ClosedLoop
from harness.limbs import cut, turned
from harness.places import ROBOTS
from harness.vrc_in_process import Commander, Network
from valor.common.behaviors import NOTHING_TO_LEAD, Behavior
from valor.common.errors import ConfigurationError, RefusalError, ValorError
from valor.common.messages import HandGoal
from valor.motion_manager.behavior_fsm import GUARDS
from valor.motion_manager.handlers.motion import HandGoalHandler
from valor.motion_manager.manager import MotionManager
from valor.robot.description import RobotDescription
from valor.robot.legs import knee, knees
from valor.robot.model import controller_model
from valor.robot.model_tree import read
from valor.self_test.acceptance import SelfTest
from valor.simulation.sensors import Sensors
from valor.valor_ros_controller.control_modes import ModeRejectedError, admit
from valor.valor_ros_controller.core import Core
from valor.valorctl.drive import arm_motion
from valor.valorctl.robots.robot_check import examine

ESCHER = RobotDescription.load(ROBOTS / "escher")
LIMBS = {
    "no hands": ("left_hand", "right_hand"), "no head": ("neck",), "one arm": ("left_arm",),
    "no arms": ("left_arm", "right_arm"), "legs alone": ("left_arm", "right_arm", "neck", "torso"),
}  # fmt: skip


@pytest.fixture(scope="module", params=list(LIMBS.values()), ids=list(LIMBS))
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RobotDescription:
    return cut(ESCHER, tmp_path_factory.mktemp("robot"), *request.param)


@pytest.fixture(scope="module")
def legs(tmp_path_factory: pytest.TempPathFactory) -> RobotDescription:
    return cut(ESCHER, tmp_path_factory.mktemp("robot"), *LIMBS["legs alone"])


@pytest.fixture(scope="module")
def one_armed(tmp_path_factory: pytest.TempPathFactory) -> RobotDescription:
    return cut(ESCHER, tmp_path_factory.mktemp("robot"), *LIMBS["one arm"])


def core(robot: RobotDescription) -> Core:
    node: Any = Network()
    return Core(robot, node, Commander, decimation=2, silence_timeout=1.0)  # type: ignore[arg-type]


def test_it_is_sound(robot: RobotDescription) -> None:
    assert not examine(robot.folder).faults


@pytest.mark.parametrize("profile", ["ideal", "hardware"])
def test_legs_alone_stand_and_walk(legs: RobotDescription, profile: str) -> None:
    played = {name: play() for name, play in SelfTest(legs, profile).tests() if name in {"stand", "walk"}}
    assert {name: result.reason for name, result in played.items()} == {"stand": "", "walk": ""}


def test_hands_that_are_not_there_feel_nothing(one_armed: RobotDescription) -> None:
    loop = ClosedLoop(one_armed, "hardware")
    sensors = Sensors(one_armed, loop.plant, one_armed.tables.actuators["hardware"].noise, 0)
    measured = sensors.measure(1, 1)
    assert not measured.left_hand_wrench.any() and measured.right_hand_wrench.all()


def test_a_goal_for_a_hand_that_is_not_there_is_refused(one_armed: RobotDescription) -> None:
    manager = MotionManager(one_armed, controller_model(one_armed))
    handler = HandGoalHandler(manager.components)
    for active in (True, False):
        goal = HandGoal(0, 0, active, "pelvis", np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
        with pytest.raises(RefusalError, match="no left hand"):
            handler.execute(Received(goal, 0, 1, "test"), 0)
    assert list(manager.components.hand_goals.sides) == [1] and not manager.components.hand_goals.leads(0)


def test_where_nothing_can_be_led_nobody_manipulates(legs: RobotDescription) -> None:
    parts = MotionManager(legs, controller_model(legs)).components
    assert not list(parts.hand_goals.sides)
    made = core(legs)
    modes = [name for name, mode in made.modes.modes.items() if mode.lacking]
    assert modes == ["stand_manipulate", "manipulate", "step_manipulate", "walk_manipulate"]
    for mode in modes:
        with pytest.raises(ModeRejectedError, match=NOTHING_TO_LEAD):
            admit(made.modes, mode, "stand", "stand", "")
    guarded = [edge for edge, guards in GUARDS.items() if edge[1].manipulating]
    assert [there for _, there in guarded] == [behavior for behavior in Behavior if behavior.manipulating]


def test_controllers_are_made_of_joints_that_there_are(robot: RobotDescription) -> None:
    made = core(robot)
    named: dict[str, Any] = dict(made.trajectories)
    named |= made.tracking
    assert all(controller.joints.size for controller in named.values())
    groups = {group for group, joints in robot.tables.groups.items() if joints and f"{group}_traj_controller" in
              core(ESCHER).table.all}  # fmt: skip
    assert set(named) == {f"{group}_traj_controller" for group in groups} | {"pelvis_traj_controller"}
    for mode in made.modes.modes.values():
        assert set(mode.joint_controllers) <= set(named)


def test_tf_and_the_description_have_no_frames_of_what_is_not_there(robot: RobotDescription) -> None:
    tree = read(robot)
    sites = {frame.target for frame in tree.frames}
    hands = {side: hand.site for side, hand in robot.tables.hands.present()}
    assert set(hands.values()) <= sites and ("l_gripper" in tree.urdf) is ("left" in hands)


def test_a_preset_of_a_limb_that_is_not_there_is_refused(one_armed: RobotDescription) -> None:
    with pytest.raises(ValorError, match="escher has no left arm"):
        arm_motion.preset(one_armed, "left", "arm", "home")
    assert arm_motion.preset(one_armed, "right", "arm", "home")


@pytest.mark.parametrize("axis", ["0 1 0", "0 -1 0"])
def test_a_knee_that_bends_both_ways_takes_the_shank_back(axis: str) -> None:
    mj = mujoco.MjModel.from_xml_string(_LEG.format(axis=axis))
    leg = dict.fromkeys(("hip", "knee", "ankle"), (-2.0, 2.0))
    assert knee(mj, mujoco.MjData(mj), leg) == ("knee", 1.0 if axis == "0 1 0" else -1.0)
    with pytest.raises(ConfigurationError, match="no joint bends the leg; expected a knee"):
        knee(mj, mujoco.MjData(mj), leg | {"knee": (0.0, 0.1)})


_LEG = """<mujoco><worldbody><body name="thigh"><joint name="hip" axis="0 1 0"/><geom size="0.01"/>
  <body pos="0 0 -0.4"><joint name="knee" axis="{axis}"/><geom size="0.01"/>
    <body pos="0 0 -0.4"><joint name="ankle" axis="0 1 0"/><geom size="0.01"/></body>
  </body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("turned_ones", [(), ("l_knee_pitch",), ("l_knee_pitch", "r_knee_pitch")])
def test_knees_are_found_whichever_way_they_turn(tmp_path: Path, turned_ones: tuple[str, ...]) -> None:
    robot = turned(ESCHER, tmp_path, turned_ones)
    found = knees(robot)
    assert [robot.joints[place] for place in found.indices] == ["l_knee_pitch", "r_knee_pitch"]
    bent = ESCHER.nominal_posture[[ESCHER.index["l_knee_pitch"], ESCHER.index["r_knee_pitch"]]]
    np.testing.assert_allclose(found.flexion(robot.nominal_posture), bent)
    np.testing.assert_allclose(found.flexion(np.array([robot.nominal_posture] * 3)), [bent] * 3)
