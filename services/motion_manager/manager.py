"""The Motion Manager without its sockets: Proprioceptor in, Motor and MotionState out.

One period: watchdogs → estimate → state machines → reference → control → Motor. Whatever happens on the way, a Motor
leaves for every Proprioceptor.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from valor.common.behaviors import Behavior, Locomotion, Manipulation
from valor.common.messages import MotionState, Motor, Proprioceptor
from valor.common.topics import PROPRIOCEPTOR
from valor.motion_manager.handlers.behavior import BehaviorHandler
from valor.motion_manager.handlers.footstep_plan import FootstepPlanHandler
from valor.motion_manager.handlers.hand_goal import HandGoalHandler
from valor.motion_manager.handlers.joint_setpoints import JointSetpointsHandler
from valor.motion_manager.handlers.pelvis import PelvisHandler
from valor.motion_manager.handlers.rejections import Rejections
from valor.motion_manager.handlers.tuning import TuningHandler
from valor.motion_manager.handlers.velocity import VelocityHandler
from valor.motion_manager.hands.hand_contact import HandContacts
from valor.motion_manager.hands.hand_goals import HandGoals
from valor.motion_manager.joints.command import MotorCommand
from valor.motion_manager.joints.joint_gains import JointGains
from valor.motion_manager.joints.joint_reference import JointReference
from valor.motion_manager.joints.upper_body import UpperBody
from valor.motion_manager.locomotion.get_up import GetUp
from valor.motion_manager.locomotion.posture_control import AT_REST, PostureControl
from valor.motion_manager.report import Reporter
from valor.motion_manager.safety.custody import BROUGHT_TO_STAND, Custody
from valor.motion_manager.safety.device_reactions import DeviceReactions
from valor.motion_manager.safety.stance import Stance
from valor.motion_manager.safety.watchdogs import ProprioceptorWatchdog
from valor.motion_manager.states.behavior_fsm import BehaviorFsm, Conditions
from valor.motion_manager.whole_body import (
    FallDetector,
    FloatingBaseEstimator,
    QpStatus,
    RobotState,
    UpperBodyReference,
    WholeBodyCommand,
    WholeBodyController,
)
from valor.motion_manager.whole_body.walking.footsteps import StepSource
from valor.motion_manager.whole_body.walking.gait import sole_poses
from valor.motion_manager.whole_body.walking.step_queue import StepQueue
from valor.motion_manager.whole_body.walking.swing import SolePose
from valor.motion_manager.whole_body.walking.velocity_steps import VelocitySteps
from valor.robot.description import RobotDescription
from valor.robot.model import Model

BLEND = 0.3  # over which the Whole-Body Controller takes the joints over [s]
FAULTS_TO_FALL = 5  # consecutive periods without a believable Proprioceptor, or with an error of ours
QP_FAILURES_TO_STOP = 25  # consecutive

_log = logging.getLogger("motion_manager")


class MotionManager:
    """Everything between one Proprioceptor and the Motor that answers it.

    Attributes:
        fsm: the Behavior FSM.
        rejections: of commands, and of what cannot be believed.
        behavior_handler: answers requests for a behavior.
        setpoints_handler: follows or refuses joint set-points.
        footstep_handler: answers footstep plans.
        velocity_handler: follows or refuses walking velocities.
        pelvis_handler: follows or refuses where the pelvis shall be.
        hand_goals: Cartesian goals of the hands; hand_goal_handler: obeys or refuses them.
        tuning_handler: obeys or refuses joint gains and balance weights.
        device_reactions: goes to safer behaviors when devices fail.
        custody: whether the robot is ours to lead.
    """

    def __init__(self, robot: RobotDescription, model: Model) -> None:
        n = len(robot.joints)
        self.fsm = BehaviorFsm()
        self.rejections = Rejections()
        self._dt = robot.control_period
        self._zeros = np.zeros(max(n, 3))
        self._estimator = FloatingBaseEstimator(robot, model)
        self._detector = FallDetector(robot)
        self._controller = WholeBodyController(robot, model)
        self._stance = Stance(robot, self._estimator.dynamics.mass * self._estimator.dynamics.gravity)
        self.custody = Custody(self.fsm, self._stance, self._swings)
        self._watchdog = ProprioceptorWatchdog(n)
        self._command = MotorCommand(robot)
        self._reference = JointReference(robot)
        self._posture = PostureControl(robot, self._reference, self._command)
        self._upper_body = UpperBody(robot, self._reference)
        self._get_up = GetUp(robot)
        self.behavior_handler = BehaviorHandler(self.fsm, self.rejections, self.conditions, self.custody.refusal)
        self.hand_goals = HandGoals(model, self._reference, robot.nominal_posture)
        self.hand_goal_handler = HandGoalHandler(self.fsm, self.hand_goals, self.rejections)
        self._gains = JointGains(robot, self._command.impedance)
        self.tuning_handler = TuningHandler(robot, self.fsm, self._gains, self._controller.weights, self.rejections)
        self._hand_contacts = HandContacts(robot.tables.hands)
        self.setpoints_handler = JointSetpointsHandler(
            robot, self.fsm, self._upper_body, self.hand_goals, self.rejections
        )
        self._velocity_steps = VelocitySteps(robot.tables.walking)
        self._step_queue = StepQueue()
        self._step_sources: dict[Locomotion, StepSource] = {
            Locomotion.STEP: self._step_queue,
            Locomotion.WALK: self._velocity_steps,
        }
        self.footstep_handler = FootstepPlanHandler(
            robot,
            self.fsm,
            self._step_queue,
            self.rejections,
            self._soles,
            recovering=lambda: self._controller.recovering,
        )
        self.velocity_handler = VelocityHandler(self.fsm, self._velocity_steps, self.rejections)
        self.pelvis_handler = PelvisHandler(self.fsm, self._controller.pelvis, self.rejections)
        self.device_reactions = DeviceReactions(self.fsm, lambda: self._controller.stepping)
        self._reporter = Reporter(self.fsm, self._command, self._controller, self.hand_goals, self._hand_contacts)
        self._recovering = False  # said to be
        self._locomotion: Locomotion | None = None  # whose control is running; None: of nobody yet
        self._state: RobotState | None = None
        self._whole_body: WholeBodyCommand | None = None  # of this period
        self._falling = ""  # what the fall detector says
        self._blend_began = 0.0
        self._sequence = 0
        self._proprioceptor_sequence = 0
        self._time = 0
        self._errors = 0  # consecutive
        self._qp_failures = 0  # consecutive

    # --- for the loop ---------------------------------------------------------------------------------------------

    @property
    def time(self) -> int:
        """Robot time [ns]."""
        return self._time

    @property
    def missed(self) -> int:
        """Proprioceptors that were not seen, since start."""
        return self._watchdog.missed

    def tick(self, proprioceptor: Proprioceptor) -> Motor:
        """The Motor that answers a Proprioceptor."""
        self._whole_body = None
        try:
            self._control(proprioceptor)
            self._errors = 0
        except Exception:
            self._errors += 1
            if self._errors == 1 or self._errors % 5000 == 0:
                _log.exception("error in a control period; the last command goes on with damping")
            self._repeat(proprioceptor)
            if self._errors >= FAULTS_TO_FALL:
                self.custody.fall("errors of the Motion Manager, see its log")
        self._sequence += 1
        self._proprioceptor_sequence = proprioceptor.sequence
        behavior = self.custody.announced(self._time)
        return self._command.message(proprioceptor.time, self._sequence, proprioceptor.sequence, behavior)

    def conditions(self) -> Conditions:
        """What the robot's condition has against transitions."""
        state = self._state
        if state is None:
            missing = "the robot's state is not known yet"
            return Conditions(missing, missing, missing, cannot_get_up=missing)
        not_prepared = "stand_prep has just begun"
        if self._locomotion is Locomotion.STAND_PREP:
            not_prepared = self._posture.not_arrived(self._time * 1e-9, state.joint_velocity)
        stepping = "the robot has not come to rest from stepping yet" if self._controller.stepping else ""
        return Conditions(
            not_prepared,
            self._stance.not_loaded(state),
            self._stance.not_upright(state) or self._falling,
            stepping,
            self._get_up.refusal(state),
        )

    def report(self, motor_time: float = 0.0, tick_time: float = 0.0) -> MotionState:
        """What the Motion Manager did and believes; the times are those that ``MotionState`` has fields for [s]."""
        seen = self._time, self._proprioceptor_sequence, self._state, self._whole_body
        return self._reporter.report(*seen, motor_time=motor_time, tick_time=tick_time)

    # --- one period -----------------------------------------------------------------------------------------------

    def _control(self, proprioceptor: Proprioceptor) -> None:
        if fault := self._watchdog.fault(proprioceptor):
            self.rejections.add(PROPRIOCEPTOR.name, "comms_manager", "malformed", fault)
            if self._watchdog.malformed >= FAULTS_TO_FALL:
                self.custody.fall(f"{self._watchdog.malformed} consecutive Proprioceptors malformed: {fault}")
            self._repeat(proprioceptor)
            return
        if self._watchdog.repeated(proprioceptor):
            return
        before, self._time = self._time, proprioceptor.time
        gap = self._watchdog.discontinuity(proprioceptor)
        custody, was_aside = self.custody, self.custody.aside
        if custody.stand_aside(proprioceptor.motor_behavior):
            self._stand_aside(proprioceptor)
            return
        if was_aside:
            gap = gap or BROUGHT_TO_STAND
        taken_over = gap is not None or not custody.ours
        if taken_over:
            self._estimator.reset()
            self._detector.reset()
            before = self._time
        state = self._state = self._estimator.update(proprioceptor)
        custody.take_over(proprioceptor.motor_behavior, self._time, gap, state)
        if taken_over and self.fsm.locomotion is not Locomotion.FALL:
            self._leave_joints(self.fsm.locomotion)
        self._watch(state)
        custody.resume(proprioceptor.motor_behavior, state)
        self.device_reactions.update()
        now = self._time * 1e-9
        if self._locomotion is self.fsm.locomotion is Locomotion.GET_UP:
            self._rise(state, now)
        self._upper_body.enter(self.fsm.manipulation, self.fsm.attention, now)
        if self.fsm.locomotion is not self._locomotion:
            self._enter(state, now)
        self._upper_body.update(now)
        self._hand_contacts.update(proprioceptor)
        self.hand_goal_handler.update()
        # Of periods that were missed, at most ten are made up for.
        dt = min(max((self._time - before) * 1e-9, self._dt), 10.0 * self._dt)
        self.hand_goals.advance(state, now, dt)
        self._reference.advance(now, dt)
        self._recover()
        self._drive(state, now, dt)
        custody.ours = True

    def _stand_aside(self, proprioceptor: Proprioceptor) -> None:
        """Somebody else has the joints. Should the robot be ours in the next moment, they stay where they are."""
        if self._locomotion is not None:
            self._leave_joints(Locomotion.IDLE)
            self._controller.leave()
        zeros = np.zeros_like(proprioceptor.joint_position)
        self._command.hold(proprioceptor.joint_position, zeros, proprioceptor.joint_effort)

    def _leave_joints(self, locomotion: Locomotion) -> None:
        """Whatever holds the joints in a state begins anew, from where they are found."""
        if self._locomotion in self._step_sources:
            self._end_stepping(locomotion)
        self._locomotion = None

    def _watch(self, state: RobotState) -> None:
        """Fall, when balance is lost."""
        self._falling = ""
        if self.fsm.locomotion.balancing or self.fsm.locomotion is Locomotion.STAND_PREP:
            self._falling = self._detector.update(state, self._controller.footholds(state)) or ""
            if self._falling and self.fsm.locomotion.balancing:
                self.custody.fall(self._falling)

    def _enter(self, state: RobotState, now: float) -> None:
        """The Locomotion FSM has another state than in the last period: hand the joints over."""
        before, locomotion = self._locomotion, self.fsm.locomotion
        self._locomotion = locomotion
        if before in self._step_sources:
            self._end_stepping(locomotion)
        if locomotion in self._step_sources:
            self._controller.pelvis.go_home()
        if locomotion.balancing:
            if before is None or not before.balancing:
                self._detector.reset()
                self._controller.reset(state)
                self._gains.reset()
                self._command.set_gains(self._gains.stiffness, self._gains.damping)
                self._qp_failures = 0
                self._blend_began = now
            return
        self._controller.leave()
        if locomotion is Locomotion.GET_UP:
            self._get_up.begin(state, now)
        if locomotion in (Locomotion.FALL, Locomotion.GET_UP):
            return
        if before is None:
            self._posture.take_up(state.joint_position, state.joint_effort)
        elif before is Locomotion.FALL:
            self._posture.take_up(state.joint_position, np.zeros_like(state.joint_effort))
        elif before.balancing or before is Locomotion.GET_UP:
            self._posture.take_over(state.joint_position)
        else:
            self._posture.hold(now)
        if locomotion is Locomotion.STAND_PREP:
            self._posture.prepare(now)

    def _drive(self, state: RobotState, now: float, dt: float) -> None:
        """Fill the command of this period."""
        if self._locomotion is Locomotion.FALL:
            self._command.limp(state.joint_position)
        elif self._locomotion is Locomotion.GET_UP:
            self._get_up.drive(self._command, state, now)
        elif self._locomotion is not None and self._locomotion.balancing:
            self._balance(state, now, dt)
        else:
            self._posture.drive(now)

    def _rise(self, state: RobotState, now: float) -> None:
        """Get Up goes on; up, the robot goes to Stand Prep by itself, and back to Fall when it cannot."""
        get_up = self._get_up
        before = get_up.progress
        get_up.update(state, now)
        if get_up.failure:
            self.custody.fall(f"getting up was given up: {get_up.failure}")
        elif get_up.done and (reason := self._stance.lost(state)):
            self.custody.fall(f"getting up was given up: {reason}")
        elif get_up.done:
            self._estimator.reset()
            self._detector.reset()
            self.fsm.go(Behavior.STAND_PREP, "up again")
        elif get_up.progress != before:
            self.fsm.remark(get_up.progress)

    def _end_stepping(self, locomotion: Locomotion) -> None:
        """Step or Walk is left: what has begun comes to rest, if somebody balances."""
        self._velocity_steps.stop()
        if locomotion.balancing:
            self._step_queue.stop(f"{self.fsm.behavior}: {self.fsm.reason}")
        else:
            self._step_queue.fail(self.fsm.reason)

    def _choose_steps(self, now: float) -> None:
        """Where steps come from, once those of another behavior have come to rest; a plan that is done: Stand."""
        self._velocity_steps.advance(now)
        if self._controller.stepping:
            return
        self._controller.step_source = self._step_sources.get(self.fsm.locomotion)
        if self._step_queue.take_finished() and self.fsm.locomotion is Locomotion.STEP:
            self.fsm.go(Behavior.STAND, self._step_queue.reason or "the footstep plan is done")

    def _soles(self) -> Sequence[SolePose]:
        """Left and right, as they are."""
        assert self._state is not None
        return sole_poses(self._state)

    def _balance(self, state: RobotState, now: float, dt: float) -> None:
        self._choose_steps(now)
        if self._gains.advance():
            self._command.set_gains(self._gains.stiffness, self._gains.damping)
        reference = self._reference
        command = self._whole_body = self._controller.update(
            state, UpperBodyReference(reference.position, reference.velocity, reference.acceleration), dt
        )
        share = min(1.0, (now - self._blend_began) / BLEND)
        effort = self._posture.effort(now) if share < 1.0 else self._zeros  # by then it counts no more
        self._command.balance(command, reference.position, reference.velocity, effort, share)
        self._qp_failures = self._qp_failures + 1 if command.qp_status is QpStatus.INFEASIBLE else 0
        if self._qp_failures >= QP_FAILURES_TO_STOP and self.fsm.may_go(Behavior.SOFT_STOP):
            self.fsm.go(
                Behavior.SOFT_STOP, f"the whole-body QP was infeasible for {self._qp_failures} periods in a row"
            )

    def _recover(self) -> None:
        """Whether a push may be answered by a step; and say so when it is.

        Hands that are led from outside and touch something may hold on to it: then the feet stay.
        """
        controller = self._controller
        holding = self.fsm.manipulation is Manipulation.TELEOP and self._hand_contacts.touching
        controller.may_recover = self.fsm.locomotion.recovering and not holding
        if controller.recovering is self._recovering:
            return
        self._recovering = controller.recovering
        if self._recovering:
            _log.warning("%s", controller.watch.reason)
            self.fsm.remark(controller.watch.reason)
        elif self.fsm.locomotion.recovering:
            self.fsm.remark(f"{self.fsm.behavior} again after a step that kept the balance")

    def _repeat(self, proprioceptor: Proprioceptor) -> None:
        """A period without a command of its own: the last one, damped; limp once the robot is in Fall."""
        if self.fsm.behavior is Behavior.FALL:
            self._locomotion = Locomotion.FALL
            self._command.limp(self._command.position)
        else:
            self._command.repeat()

    def _swings(self, state: RobotState) -> bool:
        """Whether the robot is in the middle of a step, and its legs move."""
        fastest = (self._command.force * np.abs(state.joint_velocity)).max()
        return self._controller.stepping and bool(fastest > AT_REST)
