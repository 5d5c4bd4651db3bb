"""Components of a Motion Manager."""

from collections.abc import Collection, Sequence

import numpy as np

from valor.common.behaviors import NOTHING_TO_LEAD, Manipulation
from valor.common.messages import MotionState
from valor.control.controller import ControllerFactory
from valor.control.estimation.estimator import FloatingBaseEstimator
from valor.control.fall import FallDetector
from valor.control.motor_command import MotorCommand
from valor.control.state import RobotState
from valor.control.steps import SolePose
from valor.motion_manager.behavior_fsm import BehaviorFsm, Conditions
from valor.motion_manager.handlers.handler import RejectionCounter
from valor.motion_manager.hands.hand_goals import SIDES, HandGoals
from valor.motion_manager.hands.hand_loads import HandContacts, HandLoads
from valor.motion_manager.joints.arm_pd import ArmPdControl
from valor.motion_manager.joints.joint_reference import JointReference
from valor.motion_manager.joints.servos import JointGains, ServoCompensation
from valor.motion_manager.joints.upper_body import UpperBody
from valor.motion_manager.locomotion.balance import BalanceControl
from valor.motion_manager.locomotion.driver import Drivers
from valor.motion_manager.locomotion.exchange import ControllerExchange
from valor.motion_manager.locomotion.get_up import GetUp
from valor.motion_manager.locomotion.landing import Landing
from valor.motion_manager.locomotion.posture_control import AT_REST, PostureControl
from valor.motion_manager.safety import ControlAuthority, DeviceReactions, Stance
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.whole_body.command import QpStatus, WholeBodyCommand
from valor.whole_body.controller import WholeBodyController
from valor.whole_body.walking.footsteps import StepQueue
from valor.whole_body.walking.gait import sole_poses
from valor.whole_body.walking.velocity_steps import VelocitySteps

_ZEROS = np.zeros(6)


class Components:
    """The components, and the robot state that they share."""

    def __init__(self, robot: RobotDescription, model: Model, others: Sequence[ControllerFactory] = ()) -> None:
        """``others``: controllers beside the Whole-Body Controller."""
        self.robot = robot
        self.time = 0  # robot time of the latest Proprioceptor [ns]
        self.state: RobotState | None = None  # its estimate; None before the first
        self.falling = ""  # reason of the fall detector; empty if the robot does not fall
        self.fsm = BehaviorFsm()
        self.rejections = RejectionCounter()
        self.estimator = FloatingBaseEstimator(robot, model)
        self.detector = FallDetector(robot)
        self.whole_body = WholeBodyController(robot, self.estimator.kinematics)
        self.stance = Stance(robot, self.estimator.kinematics.mass * self.estimator.kinematics.gravity)
        self.exchange = ControllerExchange(
            robot, self.whole_body, (make(robot, self.estimator.kinematics) for make in others), self.stance
        )
        self.authority = ControlAuthority(self.fsm, self.stance, self._swings)
        self.device_reactions = DeviceReactions(self.fsm, lambda: not self.exchange.at_rest)
        self.command = MotorCommand(robot)
        self.reference = JointReference(robot)
        self.gains = JointGains(robot, self.command.impedance)
        self.servos = ServoCompensation(robot, self.command)
        self.arm_pd = ArmPdControl(robot, self.command) if robot.tables.arm_control == "pd" else None
        self.upper_body = UpperBody(robot, self.reference)
        self.hand_goals = HandGoals(model, self.reference, robot.nominal_posture)
        self.hand_contacts = HandContacts(robot.tables.hands)
        self.hand_loads = HandLoads(model, self.servos)
        self.velocity_steps = VelocitySteps(robot.tables.walking)
        self.step_queue = StepQueue()
        self.posture = PostureControl(robot, self.reference, self.command)
        self.get_up = GetUp(robot)
        self.landing = Landing(robot)
        self.balance = BalanceControl(self)
        self.drivers = Drivers(self)

    def conditions(self) -> Conditions:
        """Reasons in the robot's state against transitions."""
        state = self.state
        if state is None:
            missing = "no robot state yet"
            return Conditions(missing, missing, missing, cannot_get_up=missing, nothing_to_lead=missing)
        return Conditions(
            self.drivers.not_prepared(state, self.time * 1e-9),
            self.stance.not_loaded(state),
            self.stance.not_upright(state) or self.falling,
            "the robot has not come to rest from stepping yet" if not self.exchange.at_rest else "",
            self.get_up.rejection(state),
            "" if self.upper_body.joints[Manipulation].any() else NOTHING_TO_LEAD,
        )

    def freeze(self, limbs: Collection[str]) -> None:
        """Freeze exactly these limbs, with nominal gains; joints driven by force where they are."""
        assert self.state is not None
        for side in self.hand_goals.sides:
            if (arm := f"{SIDES[side]}_arm") in limbs:
                self.hand_goals.release(side, f"{arm} is frozen")
        self.upper_body.freeze(limbs, self.command.force, self.state.joint_position, self.time * 1e-9)
        frozen = np.flatnonzero(self.reference.frozen & self.gains.impedance)
        self.gains.request(frozen, self.robot.servo_stiffness[frozen], self.robot.servo_damping[frozen])

    def soles(self) -> Sequence[SolePose]:
        """Estimated poses of the left and right sole in odom."""
        assert self.state is not None
        return sole_poses(self.state)

    def report(self, proprioceptor_sequence: int, *, motor_time: float, tick_time: float) -> MotionState:
        """State of the Motion Manager after a period; for the times see ``MotionState`` [s]."""
        fsm, state, command, pelvis = self.fsm, self.state, self.balance.command, self.whole_body.pelvis
        planned = command if isinstance(command, WholeBodyCommand) else None
        # Without a plan, the DCM is its own reference.
        dcm_reference = state.dcm_in_odom if state else _ZEROS[:3]
        if planned is not None:
            dcm_reference = planned.dcm_reference_in_odom
        return MotionState(
            time=self.time,
            proprioceptor_sequence=proprioceptor_sequence,
            setpoint_sequence=self.upper_body.setpoint_sequence,
            behavior=fsm.behavior,
            locomotion=fsm.locomotion,
            manipulation=fsm.manipulation,
            attention=fsm.attention,
            reason=fsm.reason,
            pelvis_position_in_odom=state.pelvis_position_in_odom if state else _ZEROS[:3],
            pelvis_orientation_in_odom=state.pelvis_orientation_in_odom if state else np.eye(4)[0],
            pelvis_linear_velocity_in_odom=state.pelvis_linear_velocity_in_odom if state else _ZEROS[:3],
            pelvis_angular_velocity_in_pelvis=state.pelvis_angular_velocity_in_pelvis if state else _ZEROS[:3],
            com_in_odom=state.com_in_odom if state else _ZEROS[:3],
            dcm_in_odom=state.dcm_in_odom if state else _ZEROS[:3],
            dcm_reference_in_odom=dcm_reference,
            cop_in_odom=state.cop_in_odom if state else np.full(2, np.nan),
            contacts=state.contacts if state else np.zeros(2, dtype=np.uint8),
            contact_probability=state.contact_probability if state else _ZEROS[:2],
            pelvis_position_variance=state.pelvis_position_variance if state else _ZEROS[:3],
            pelvis_orientation_variance=state.pelvis_orientation_variance if state else _ZEROS[:3],
            pelvis_linear_velocity_variance=state.pelvis_linear_velocity_variance if state else _ZEROS[:3],
            hand_contacts=self.hand_contacts.contacts,
            left_arm=self._arm_source(0),
            right_arm=self._arm_source(1),
            joint_setpoint=self.command.wanted,
            pelvis_setpoint=pelvis.position,
            pelvis_in_support=pelvis.measured(state) if state else _ZEROS,
            desired_foot_forces=planned.desired_foot_forces if planned else _ZEROS[:2],
            qp_status=int(planned.qp_status if planned else QpStatus.NOT_RUN),
            qp_failures=self.whole_body.qp_failures,
            torque_saturations=self.command.saturations,
            motor_time=motor_time,
            tick_time=tick_time,
        )

    def _arm_source(self, side: int) -> str:
        """Command source of an arm (0 left, 1 right), or frozen."""
        if f"{SIDES[side]}_arm" in self.upper_body.frozen:
            return "frozen"
        if self.fsm.manipulation is not Manipulation.TELEOP or not self.robot.tables.group(f"{SIDES[side]}_arm"):
            return "nobody"
        return "hand_goal" if self.hand_goals.leads(side) else "setpoints"

    def _swings(self, state: RobotState) -> bool:
        fastest = (self.command.force * np.abs(state.joint_velocity)).max()
        return not self.exchange.at_rest and bool(fastest > AT_REST)
