"""What a Motion Manager is made of, put together in one place: who needs a part takes it from here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valor.common.behaviors import Locomotion
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.hands.hand_contact import HandContacts
from valor.motion_manager.hands.hand_goals import HandGoals
from valor.motion_manager.joints.joint_gains import JointGains
from valor.motion_manager.joints.joint_reference import JointReference
from valor.motion_manager.joints.upper_body import UpperBody
from valor.motion_manager.locomotion.balance import BalanceControl, Balanced, Stepping
from valor.motion_manager.locomotion.driver import Drivers
from valor.motion_manager.locomotion.drivers import Held, Limp, Prepared, Rising
from valor.motion_manager.locomotion.get_up import GetUp
from valor.motion_manager.locomotion.posture_control import AT_REST, PostureControl
from valor.motion_manager.safety.custody import Custody
from valor.motion_manager.safety.device_reactions import DeviceReactions
from valor.motion_manager.safety.stance import Stance
from valor.motion_manager.states.behavior_fsm import BehaviorFsm, Conditions
from valor.robot.description import RobotDescription
from valor.robot.model import Model
from valor.whole_body.balance.fall import FallDetector
from valor.whole_body.controller import WholeBodyController
from valor.whole_body.estimation.estimator import FloatingBaseEstimator
from valor.whole_body.motor_command import MotorCommand
from valor.whole_body.state import RobotState
from valor.whole_body.walking.gait import sole_poses
from valor.whole_body.walking.step_queue import StepQueue
from valor.whole_body.walking.swing import SolePose
from valor.whole_body.walking.velocity_steps import VelocitySteps


class Parts:
    """The parts, and what they know of the robot together.

    Attributes:
        time: robot time of the newest Proprioceptor [ns].
        state: estimated from it; None: not known yet.
        falling: what the fall detector says of it; an empty text: nothing.
    """

    def __init__(self, robot: RobotDescription, model: Model) -> None:
        self.robot = robot
        self.time = 0
        self.state: RobotState | None = None
        self.falling = ""
        self.fsm = BehaviorFsm()
        self.rejections = Rejections()
        self.estimator = FloatingBaseEstimator(robot, model)
        self.detector = FallDetector(robot)
        self.controller = WholeBodyController(robot, model)
        self.stance = Stance(robot, self.estimator.dynamics.mass * self.estimator.dynamics.gravity)
        self.custody = Custody(self.fsm, self.stance, self._swings)
        self.device_reactions = DeviceReactions(self.fsm, lambda: self.controller.stepping)
        self.command = MotorCommand(robot)
        self.reference = JointReference(robot)
        self.gains = JointGains(robot, self.command.impedance)
        self.upper_body = UpperBody(robot, self.reference)
        self.hand_goals = HandGoals(model, self.reference, robot.nominal_posture)
        self.hand_contacts = HandContacts(robot.tables.hands)
        self.velocity_steps = VelocitySteps(robot.tables.walking)
        self.step_queue = StepQueue()
        self.posture = PostureControl(robot, self.reference, self.command)
        self.get_up = GetUp(robot)
        self.balance = BalanceControl(
            robot,
            self.fsm,
            controller=self.controller,
            detector=self.detector,
            reference=self.reference,
            posture=self.posture,
            motors=self.command,
            gains=self.gains,
            velocity_steps=self.velocity_steps,
            step_queue=self.step_queue,
        )
        self.drivers = self._make_drivers()

    def _make_drivers(self) -> Drivers:
        """One for each state of the Locomotion FSM."""
        controller, command, posture = self.controller, self.command, self.posture
        return Drivers(
            self.fsm,
            {
                Locomotion.IDLE: Held(controller, posture),
                Locomotion.STAND_PREP: Prepared(controller, posture),
                Locomotion.STAND: Balanced(self.balance),
                Locomotion.STEP: Stepping(self.balance, self.step_queue),
                Locomotion.WALK: Stepping(self.balance, self.velocity_steps),
                Locomotion.SOFT_STOP: Balanced(self.balance),
                Locomotion.FREEZE: Held(controller, posture),
                Locomotion.FALL: Limp(controller, command),
                Locomotion.GET_UP: Rising(
                    fsm=self.fsm,
                    custody=self.custody,
                    stance=self.stance,
                    estimator=self.estimator,
                    detector=self.detector,
                    controller=controller,
                    command=command,
                    get_up=self.get_up,
                ),
            },
        )

    def conditions(self) -> Conditions:
        """What the robot's condition has against transitions."""
        state = self.state
        if state is None:
            missing = "the robot's state is not known yet"
            return Conditions(missing, missing, missing, cannot_get_up=missing)
        return Conditions(
            self.drivers.not_prepared(state, self.time * 1e-9),
            self.stance.not_loaded(state),
            self.stance.not_upright(state) or self.falling,
            "the robot has not come to rest from stepping yet" if self.controller.stepping else "",
            self.get_up.refusal(state),
        )

    def soles(self) -> Sequence[SolePose]:
        """Left and right, as they are."""
        assert self.state is not None
        return sole_poses(self.state)

    def _swings(self, state: RobotState) -> bool:
        """Whether the robot is in the middle of a step, and its legs move."""
        fastest = (self.command.force * np.abs(state.joint_velocity)).max()
        return self.controller.stepping and bool(fastest > AT_REST)
