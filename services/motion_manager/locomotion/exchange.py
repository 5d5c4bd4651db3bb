"""Exchange of the controller in control while the robot stands or walks.

The next controller first runs in shadow: it receives the robot's states, and its commands are checked but not executed.
Once they have been sound for a while and both feet carry weight, the torques of both controllers are blended. If
another controller than the Whole-Body Controller fails (``supervision``), the Whole-Body Controller takes over at once,
lowers a foot in the air, and brings the robot to rest; then the behavior changes to Soft Stop.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from valor.common.arrays import FloatArray
from valor.common.behaviors import Locomotion
from valor.common.messages import ControllerStatus
from valor.control.controller import Controller, JointCommand, JointTargets, Request
from valor.control.fall import SupportPolygon
from valor.control.state import RobotState
from valor.motion_manager.locomotion.supervision import Supervised
from valor.motion_manager.safety import Stance
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import WHOLE_BODY
from valor.whole_body.controller import WholeBodyController

STARTED = 0.5  # duration of balance before an exchange, longer than the blend from the servos [s]
SHADOW = 0.1  # duration of sound commands before control [s]
BLEND = 0.3  # from one controller to the next [s]
QUICK = 0.1  # to the Whole-Body Controller, from one that failed [s]
WAITING = 3.0  # longest time for the conditions of an exchange; half of it for rest [s]
STILL = 0.05  # speed of the CoM at rest [m/s]
INSIDE = 0.03  # least distance of the DCM inside the support polygon, between steps, fraction of the leg's length
CALM = 0.2  # duration at rest before steps, after an exchange [s]
SETTLED, LONGEST = 0.5, 4.0  # duration at rest before Soft Stop, after a failure; longest time until then [s]


def blended(one: JointCommand, other: JointCommand, share: float) -> JointCommand:
    """Command whose torques are ``other``'s with weight ``share`` and ``one``'s with the rest, at any state."""
    rest = 1.0 - share
    stiffness, damping = rest * one.stiffness + share * other.stiffness, rest * one.damping + share * other.damping
    position, velocity = rest * one.position + share * other.position, rest * one.velocity + share * other.velocity
    pull = rest * one.stiffness * one.position + share * other.stiffness * other.position
    drag = rest * one.damping * one.velocity + share * other.damping * other.velocity
    return JointCommand(
        np.divide(pull, stiffness, out=position, where=stiffness > 0.0),
        np.divide(drag, damping, out=velocity, where=damping > 0.0),
        rest * one.effort + share * other.effort,
        stiffness,
        damping,
    )


class ControllerExchange:
    """The controllers of a robot, and which of them is in control.

    Attributes:
        active: the controller in control.
        chosen: state of the Locomotion FSM → name of the controller that is to serve it.
        pending: name of the controller that is to take over next; empty: none.
        reason: of the last exchange, or of the rejection of one.
        failed: fault of the last controller, while the robot is brought to rest because of it; else empty.
        changes: number of changes of any of these.
    """

    def __init__(
        self,
        robot: RobotDescription,
        whole_body: WholeBodyController,
        others: Iterable[Controller],
        stance: Stance,
    ) -> None:
        self._robot, self._whole_body, self._stance = robot, whole_body, stance
        self._others = {each.name: Supervised(robot, each, stance) for each in others}
        self._support, self._inside = SupportPolygon(robot.tables.feet), INSIDE * robot.tables.size.leg
        self.allowed = robot.tables.controllers.names()
        self.chosen = {state: names[0] for state, names in self.allowed.items()}
        self.active: Controller = whole_body
        self.pending = self.reason = self.failed = ""
        self.changes = 0
        self._command: JointCommand | None = None  # in force
        self._since = 0.0  # beginning of the wait for the pending controller, or of the rest after a failure [s]
        self._old: Controller | None = None  # whose commands fade out
        self._old_command: JointCommand | None = None
        self._blend = (0.0, BLEND)  # its start and duration [s]
        self._balanced = self._calm = 0.0  # duration of balance, and at rest [s]
        self._arriving = False  # whether the Whole-Body Controller still brings the robot to rest

    @property
    def names(self) -> tuple[str, ...]:
        """All controllers."""
        return (WHOLE_BODY, *self._others)

    @property
    def at_rest(self) -> bool:
        """True if no step is under way."""
        return self.active.at_rest

    @property
    def resting(self) -> bool:
        """True while the robot comes to rest for an exchange, and steps wait for who is to take them."""
        return bool(self.pending) or self._arriving

    def footholds(self, state: RobotState) -> tuple[FloatArray, FloatArray] | None:
        """Soles after the step under way, see ``Controller``; if the controller does not know, under the DCM."""
        found = self.active.footholds(state)
        if found is not None or self.active is self._whole_body:
            return found
        if self.active.at_rest and not self.active.steps_to_balance:
            return None
        positions = state.sole_positions_in_odom.copy()
        positions[int(state.foot_forces.argmin()), :2] = state.dcm_in_odom[:2]
        return positions, state.sole_rotations_in_odom

    def choose(self, name: str, state: RobotState | None) -> str:
        """Choose a controller for all states that may have it; returns the reason of a rejection, or an empty text."""
        states = [each for each, names in self.allowed.items() if name in names and each in self.named(name).states]
        if name not in self.names or not states:
            lists = "; ".join(f"{each}: {', '.join(names)}" for each, names in self.allowed.items())
            return f"no controller {name[:64]!r} for this robot; expected of its robot.yaml, controllers: {lists}"
        if self.failed:
            return f"the robot is brought to rest: {self.failed}"
        controller = self.named(name)
        controller.chosen()
        if state is not None and (refusal := controller.refusal(state)):
            return refusal
        self.chosen |= dict.fromkeys(states, name)
        self.changes += 1
        return ""

    def status(self, time: int) -> ControllerStatus:
        """Return the status at robot time ``time`` [ns]."""
        lists = [sorted(names, key=lambda name: name != self.chosen[each]) for each, names in self.allowed.items()]
        stand, walk = lists
        return ControllerStatus(time, self.active.name, self.pending, self.reason, stand, walk)

    def begin(self, state: RobotState) -> None:
        """Start with the Whole-Body Controller, from servos that held the joints."""
        self.end()
        self._whole_body.begin(state)

    def end(self) -> None:
        """Give up control."""
        self._withdraw()
        for controller in (self.active, self._old, self._whole_body):
            if controller is not None:
                controller.end()
        self.active, self._old, self._old_command, self._command = self._whole_body, None, None, None
        self.failed, self._balanced = "", 0.0

    def update(self, state: RobotState, request: Request, dt: float, now: float) -> JointCommand:
        """Command of a period of ``dt`` [s] at robot time ``now`` [s]."""
        self._calm = self._calm + dt if self._whole_body.at_rest and state.com_speed < STILL else 0.0
        if self.failed:
            request = replace(request, locomotion=Locomotion.STAND, steps=None, velocity=np.zeros(3))
        self._balanced += dt
        early = self._balanced < STARTED
        wanted = WHOLE_BODY if early or self.failed else self._wanted(request.locomotion)
        if wanted == self.active.name:
            self._withdraw()
        elif wanted != self.pending:
            self._prepare(wanted, state, now)
        if self.pending:
            self._take_up(state, request, dt, now)
        self._arriving = self._arriving and self._calm < CALM
        if self.resting:
            request = replace(request, steps=None, velocity=np.zeros(3))
        command = self._of(self.active, state, request, dt)
        if command is None:
            self._fail(state, now)
            command = self._of(self._whole_body, state, request, dt)
            assert command is not None
        self._command = command = self._faded(command, state, request, dt, now)
        return command

    def settled(self, now: float) -> str:
        """Return the fault of a controller once the robot is at rest after it; empty before, and without one."""
        if not self.failed:
            return ""
        if self._calm < SETTLED and now - self._since < LONGEST:
            return ""
        fault, self.failed = self.failed, ""
        return fault

    def named(self, name: str) -> Controller:
        """Return a controller by its name; the Whole-Body Controller if there is none."""
        return self._others[name].controller if name in self._others else self._whole_body

    def _wanted(self, locomotion: Locomotion) -> str:
        """Name of the controller that is to serve a state; plans of footsteps go to who takes them."""
        if locomotion is Locomotion.STEP and self.named(self.chosen[Locomotion.WALK]).takes_footsteps:
            return self.chosen[Locomotion.WALK]
        return self.chosen.get(locomotion, WHOLE_BODY)

    def _prepare(self, name: str, state: RobotState, now: float) -> None:
        """Let a controller run in shadow."""
        self._withdraw()
        self.pending, self._since = name, now
        self.changes += 1
        if name != WHOLE_BODY:
            self._others[name].begin(state, self._command)

    def _withdraw(self) -> None:
        if self.pending:
            if self.pending in self._others:
                self._others[self.pending].controller.end()
            self.pending = ""
            self.changes += 1

    def _take_up(self, state: RobotState, request: Request, dt: float, now: float) -> None:
        """Exchange the controllers if the conditions hold; reject the exchange if they do not for too long."""
        name, waited, supervised = self.pending, now - self._since, self._others.get(self.pending)
        reason, fault = self._unready(state, waited), ""
        if supervised is not None:
            supervised.update(state, replace(request, velocity=np.zeros(3), steps=None), dt)
            fault, shadow = supervised.fault, max(SHADOW, supervised.controller.warm_up)
            reason = fault or reason or supervised.controller.refusal(state)
            if not reason and supervised.sound < shadow:
                reason = f"its commands were sound for {supervised.sound:.3f} s; expected {shadow:.3f} s"
        elif request.locomotion is Locomotion.SOFT_STOP:
            reason = ""
        if not reason:
            self._exchange(self.named(name), state, now, BLEND)
        elif fault or waited > WAITING:
            self._reject(reason)

    def _unready(self, state: RobotState, waited: float) -> str:
        """Reason why a state is not one for an exchange; empty if the robot is at rest, or later, between two steps."""
        if (reason := self._stance.not_loaded(state)) or self.active.at_rest:
            return reason
        if waited < 0.5 * WAITING:
            return "the robot does not come to rest"
        depth = self._support.dcm_outside(state, -self._inside)
        if depth is None:
            return ""
        return f"the DCM is {-depth:.3f} m inside the support polygon; expected at least {self._inside:.3f} m"

    def _reject(self, reason: str) -> None:
        """Return the choice of the pending controller to the one in control, where it is allowed."""
        name, active = self.pending, self.active.name
        for state, names in self.allowed.items():
            if self.chosen[state] == name and active in (WHOLE_BODY, *names):
                self.chosen[state] = active
        self._withdraw()
        self.reason = f"{name} does not take over: {reason}"

    def _exchange(self, controller: Controller, state: RobotState, now: float, duration: float) -> None:
        before = self.active
        self._old, self._old_command, self._blend = before, self._command, (now, duration)
        self.active, self.pending = controller, ""
        self.reason = f"{controller.name} after {before.name}"
        self.changes += 1
        if controller is self._whole_body:
            self._whole_body.begin(state, self._command)
            self._whole_body.catch(state)
            self._arriving, self._calm = True, 0.0

    def _fail(self, state: RobotState, now: float) -> None:
        """Return control to the Whole-Body Controller at once, because the active one has a fault."""
        name = self.active.name
        self._exchange(self._whole_body, state, now, QUICK)
        self.failed = self.reason = f"{name}: {self._others[name].fault}"
        self.chosen = dict.fromkeys(self.chosen, WHOLE_BODY)
        self._since = now
        assert self._old is not None
        self._old.end()
        self._old = None  # its last command fades out

    def _of(self, controller: Controller, state: RobotState, request: Request, dt: float) -> JointCommand | None:
        """Command of a controller, completed for the joints that it does not command; None after a fault."""
        if controller is self._whole_body:
            return controller.update(state, request, dt)
        command = self._others[controller.name].update(state, request, dt)
        return None if command is None else self._completed(command, controller, state, request.joints)

    def _completed(
        self, command: JointCommand, controller: Controller, state: RobotState, targets: JointTargets
    ) -> JointCommand:
        own, kinematics = controller.joints, state.kinematics
        kinematics.evaluate_bias()
        weight = np.zeros_like(command.effort)
        weight[kinematics.joints.places] = kinematics.bias[6:]
        fastest = self._robot.velocity_limit
        return JointCommand(
            np.where(own, command.position, targets.position),
            np.where(own, np.clip(command.velocity, -fastest, fastest), targets.velocity),
            np.where(own, command.effort, weight),
            np.where(own, command.stiffness, targets.stiffness),
            np.where(own, command.damping, targets.damping),
        )

    def _faded(self, command: JointCommand, state: RobotState, request: Request, dt: float, now: float) -> JointCommand:
        """Blend a command with the fading ones of the controller before."""
        if self._old_command is None:
            return command
        began, duration = self._blend
        share = (now - began) / duration
        if share >= 1.0:
            if self._old is not None:
                self._old.end()
            self._old = self._old_command = None
            return command
        if self._old is not None and (still := self._of(self._old, state, replace(request, steps=None), dt)):
            self._old_command = still
        return blended(self._old_command, command, share)
