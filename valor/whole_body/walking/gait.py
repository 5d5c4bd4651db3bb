"""The gait: transfer the weight, swing a foot, transfer, swing, … until there are no more steps, then stand.

    at rest ─► transfer ─► swing ─► transfer ─► swing ─► … ─► last transfer ─► at rest

Steps are asked for when a transfer begins, and the DCM is planned anew from where its reference is, over the soles as
they really stand: so a plan may change with every step, and a foot that came down elsewhere is no error any more. What
is planned for later is forgotten by the DCM with e^{−ωt}; three steps ahead are enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, inf, sqrt

import numpy as np

from valor.common.arrays import FloatArray
from valor.robot.description import RobotDescription
from valor.robot.footsteps import LEFT, RIGHT
from valor.robot.motion_tables import Walking
from valor.robot.size import ESCHER
from valor.whole_body.state import RobotState
from valor.whole_body.tuning_tables import Tuning
from valor.whole_body.walking.dcm_plan import DcmPlan
from valor.whole_body.walking.footsteps import Step, StepSource
from valor.whole_body.walking.recovery import RecoverySteps
from valor.whole_body.walking.step_guard import StepGuard
from valor.whole_body.walking.swing import SolePose, SwingPoint, SwingTrajectory

AHEAD = 3  # steps planned
HIPS_AHEAD = 0.05  # of midway between the feet when the rear one leaves the ground, by ESCHER's leg [m]
QUICK_DEPTH, UNHURRIED = 0.12, 3.0  # share of the depth at full speed; how soon it grows to all of it below that
SHORTEST_PIECE = 0.01  # of a plan [s]
FOLLOWED = 1e-3  # moves of a late foot's foothold below it are none [m]
MOST_LOWERED = 0.12  # the CoM, whatever the step, by ESCHER's leg [m]
EARLY = 0.15  # of a swing's duration: a foot that was found in the air may be about to land
LOWERING = 8.0  # with which it is lowered for a step that goes further than planned [1/s]


class Gait:
    """Where DCM and feet shall be while the robot steps.

    Attributes:
        active: whether it steps; the rest is of meaning only then.
        dcm: (3,), vrp: (3,) references in odom, of a robot with nominal arms [m].
        load: (2,) how much each foot may push: 0 not at all, 1 as it likes.
        swinging: the foot in the air, or None.
        swing: where it shall be.
        foothold: where it shall come down, or None.
        source: of the steps.
    """

    def __init__(self, robot: RobotDescription, omega: float, com_height: float) -> None:
        """Args: omega: ω [1/s]. com_height: of the CoM above the soles [m]."""
        self._table, self._omega = robot.tables.walking, omega
        feet = robot.tables.feet
        self._centres = [np.array(((foot.heel + foot.toe) / 2.0, 0.0, 0.0)) for foot in (feet.left, feet.right)]
        self._toes = (feet.left.toe, feet.right.toe)
        self._height = np.array((0.0, 0.0, com_height))
        self.source: StepSource
        self._step: Step | None = None
        self._plan: DcmPlan
        self._guard = StepGuard(robot, omega)
        self._trajectory: SwingTrajectory
        self._time = 0.0  # since the transfer began [s]
        self._transfer = 0.0  # duration of it [s]
        self._resting = 0  # the plan's piece in which the VRP rests over the next stance foot
        self._early = 0.0  # that the last foot came down before its time [s]
        self._landed: int | None = None
        self._sways = True  # before the first step
        self._earliest = 0.0  # of the swing's duration: the foot may have landed
        size = robot.tables.size.leg / ESCHER.leg
        self._hips_ahead, self._most_lowered = size * HIPS_AHEAD, size * MOST_LOWERED
        # Feet that stand farther apart than ESCHER's would are below hips that are so: no leg leans for that.
        self._wide = max(0.0, self._table.step_width - size * Walking().step_width)
        self._giving = robot.read(Tuning).disturbance.giving
        self._planned_lowering = 0.0  # of the CoM over the stance foot [m]
        self._lower = self._lowered = 0.0  # by how much more it shall be, and is, for a step that was adjusted [m]
        self.active = False
        self.dcm, self.vrp = np.zeros(3), np.zeros(3)
        self.load = np.ones(2)
        self.swinging: int | None = None
        self.swing: SwingPoint
        self.foothold: SolePose | None = None

    def start(
        self, state: RobotState, source: StepSource, dcm: FloatArray, vrp: FloatArray, *, urgent: bool = False
    ) -> bool:
        """Begin to step from rest if the source has steps.

        Args:
            state: the robot's.
            source: of the steps.
            dcm: (3,) reference of standing, which the gait goes on from [m].
            vrp: (3,) likewise [m].
            urgent: at once, without swaying aside first: the DCM is elsewhere anyway, and the step goes there.
        """
        steps = source.upcoming(sole_poses(state))
        if not steps:
            return False
        self.active = True
        self.dcm, self.vrp = dcm, vrp
        self._early, self._landed = 0.0, None
        self.source = source
        self._sways = not urgent
        self._begin_transfer(state, steps, 0.0 if urgent else self._table.first_transfer_duration)
        return True

    def recover(self, state: RobotState, source: RecoverySteps, dcm: FloatArray, vrp: FloatArray) -> None:
        """Begin to step at once, with the foot that keeps the balance better.

        Args:
            state: the robot's, with both feet on the ground.
            source: of the steps.
            dcm: (3,) measured, were its arms nominal [m].
            vrp: (3,) reference [m].
        """
        if self.active:
            self.source.rested()

        def begin(foot: int) -> float:
            source.lead(foot)
            self.start(state, source, dcm, vrp, urgent=True)
            return self._guard.cost(dcm - self._plan.at(0.0)[0])

        begin(min((LEFT, RIGHT), key=begin))

    def catch(self, state: RobotState, source: RecoverySteps, foot: int, dcm: FloatArray) -> None:
        """Go on from a robot that is found with a foot in the air: that foot comes down where the DCM needs it.

        Args:
            state: the robot's.
            source: of the steps.
            foot: in the air.
            dcm: (3,) measured, were its arms nominal [m].
        """
        source.lead(foot)
        soles = sole_poses(state)
        step, *others = source.upcoming(soles)
        step = replace(step, transfer_duration=SHORTEST_PIECE)  # the weight is over the other foot already
        self.active, self.source = True, source
        self.dcm, self.vrp = dcm, self._over(soles[1 - foot], 1 - foot)
        self._early, self._landed, self._sways = 0.0, None, False
        self._begin_transfer(state, (step, *others))
        self._time = self._transfer
        self._begin_swing(state, step)
        self._earliest = EARLY

    @property
    def stepping(self) -> int | None:
        """The foot whose step is under way, in the air or about to be; None: the robot rests, or sways from rest."""
        return None if self._step is None or self._sways else self._step.foot

    @property
    def resting(self) -> bool:
        """Whether no step is under way or to come: both feet stand, and stay."""
        return self._step is None

    def stop(self) -> None:
        """Forget everything: somebody else has the legs."""
        self.active = False
        self.swinging = self.foothold = self._step = None
        self.load[:] = 1.0

    def update(self, state: RobotState, dcm: FloatArray, dt: float) -> None:
        """One period.

        Args:
            state: the robot's.
            dcm: (3,) its DCM, were its arms nominal [m].
            dt: since the last period [s].
        """
        self._time += dt
        if self.swinging is None:
            if self._time >= self._transfer:
                if self._step is None:
                    self.stop()
                    self.source.rested()
                    return
                self._begin_swing(state, self._step)
        elif self._touched(state, self.swinging):
            self._end_swing(state)
        before = self.dcm
        self.dcm, self.vrp = self._plan.at(self._time)
        self._sink(dt)
        if self._step is not None:
            if self.swinging is not None and self._time > self._transfer + self._step.swing_duration:
                self._wait(before, dcm, dt)
            else:
                self._give_way(state, dcm, self._step)
        self._feet()

    # --- phases ---------------------------------------------------------------------------------------------------

    def _begin_transfer(self, state: RobotState, steps: Sequence[Step], shortest: float = 0.0) -> None:
        """Towards the next step, or to rest."""
        self._time = self._lower = self._lowered = 0.0
        if steps:
            self._step, self.foothold = steps[0], steps[0].sole
            self._transfer = max(shortest, steps[0].transfer_duration) + self._early
            self.source.began(steps[0])
        else:
            self._step = self.foothold = None
            self._transfer = self._table.last_transfer_duration + self._early
        soles = sole_poses(state)
        self._plan_dcm(soles, steps)
        if steps:
            step, stance = steps[0], 1 - steps[0].foot
            touchdown = self._transfer + step.swing_duration
            self._guard.begin(
                step,
                soles[stance],
                self._plan.at_end(self._resting)[1],
                landing_dcm=self._plan.at_end(self._resting)[0],
                touchdown=touchdown,
                transfer=steps[1].transfer_duration if len(steps) > 1 else self._table.transfer_duration,
            )

    def _plan_dcm(self, soles: list[SolePose], steps: Sequence[Step]) -> None:
        """The VRP's knots over the soles as they stand and will stand, and the DCM through them."""
        durations, knots = [], [self.vrp]
        early = self._early if self._early > SHORTEST_PIECE else 0.0
        if early:  # the VRP stays for as long as it was to stay
            durations.append(early)
            knots.append(self.vrp)
        first = len(durations)
        poses = list(soles)
        lowered = 0.0  # by what the step before asks for
        for i, step in enumerate(steps[:AHEAD]):
            stance = self._over(poses[1 - step.foot], 1 - step.foot)
            before, lowered = lowered, self._lowering(poses[1 - step.foot], step.sole)
            lower = max(before, lowered, self._lowering(poses[0], poses[1]) if i == 0 else 0.0)
            stance[2] -= lower
            if i == 0:
                self._planned_lowering = lower
            transfer = self._transfer - early if i == 0 else step.transfer_duration
            if i == 0 and self._sways:  # from rest: sway aside first
                durations += [0.5 * transfer, 0.5 * transfer]
                knots += [0.5 * (self.vrp + stance), stance]
            else:
                durations.append(transfer)
                knots.append(stance)
            durations.append(step.swing_duration)
            knots.append(stance)
            poses[step.foot] = step.sole
        rest = 0.5 * (self._over(poses[0], 0) + self._over(poses[1], 1))
        if steps:
            durations.append(self._table.last_transfer_duration)
            knots.append(rest)
        else:
            half = 0.5 * (self._transfer - early)
            durations += [half, half]
            knots += [0.5 * (self.vrp + rest), rest]
        self._resting = first + (2 if self._sways else 1)
        over_stance, sway = slice(self._resting, self._resting + 2), slice(first + 1, first + 2)
        if self._sways or not steps:
            giving, most = sway, inf
        else:  # all over the next stance, as far as its sole can push: the rest is for the steps to make good
            giving, most = over_stance, 0.0 if self._landed is None else self._giving
        self._plan = DcmPlan(self._omega, durations, np.array(knots), self.dcm, giving, most=most)
        if steps:  # a foot that is late must be waited for
            self._plan.hold(self._resting)

    def _over(self, sole: SolePose, foot: int) -> FloatArray:
        """(3,) the VRP over the middle of a sole, in odom [m]."""
        place: FloatArray = sole.position + sole.rotation @ self._centres[foot] + self._height
        return place

    def _depth(self, duration: float) -> float:
        """How far below its foothold a foot is led [m]: a quick one has no time to be early for holes."""
        table = self._table
        ease = (duration - table.fast_swing_duration) / (table.swing_duration - table.fast_swing_duration)
        return table.touchdown_depth * min(1.0, max(QUICK_DEPTH, UNHURRIED * ease))

    def _lowering(self, one: SolePose, other: SolePose) -> float:
        """How much lower than nominal the CoM must be so that no leg is stretched further than its reach [m].

        Weight goes from foot to foot with the hips about midway, and half of a difference in height still to go.
        """
        table = self._table
        x, y, z = map(float, other.position - one.position)
        away = 0.5 * hypot(x, max(0.0, abs(y) - self._wide)) + self._hips_ahead
        straight = table.leg_reach * table.leg_reach - away * away
        if straight <= 0.0:
            return self._most_lowered
        return min(self._most_lowered, max(0.0, table.hip_height + 0.5 * abs(z) - sqrt(straight)))

    def _begin_swing(self, state: RobotState, step: Step) -> None:
        table = self._table
        self.swinging, self._earliest = step.foot, table.earliest_touchdown
        self._trajectory = SwingTrajectory(
            sole_poses(state)[step.foot],
            step.sole,
            height=step.swing_height,
            duration=step.swing_duration,
            depth=self._depth(step.swing_duration),
            descent=table.descent,
            late_descent=table.late_descent,
            toe=self._toes[step.foot],
        )

    def _give_way(self, state: RobotState, dcm: FloatArray, step: Step) -> None:
        """Take the step elsewhere, or at another time, where the DCM needs it."""
        guard, time = self._guard, self._time
        swinging = self.swinging is not None
        found = guard.update(time, self._transfer, sole_poses(state)[step.foot], dcm - self.dcm)
        if found is not None:
            sole = SolePose(found.foothold, step.sole.rotation)
            duration = step.swing_duration
            if swinging:
                duration = time - self._transfer + found.left
                self._trajectory.retarget(time - self._transfer, sole, duration)
            self._step, self.foothold = replace(step, sole=sole, swing_duration=duration), sole
            stance = sole_poses(state)[1 - step.foot]
            self._lower = max(0.0, self._lowering(stance, sole) - self._planned_lowering)
        if guard.adjusted is not None and swinging:
            assert self._step is not None
            left = self._transfer + self._step.swing_duration - time
            self.dcm[:2], self.vrp[:2] = guard.reference(left)[:2], guard.centre[:2]  # heights are the plan's

    def _sink(self, dt: float) -> None:
        """Lead the CoM lower than planned, as far as the step asks for: ξ_z and its VRP go on to belong together."""
        rate = LOWERING * (self._lower - self._lowered)
        self._lowered += rate * dt
        self.dcm[2] -= self._lowered
        self.vrp[2] -= self._lowered - rate / self._omega

    def _wait(self, before: FloatArray, dcm: FloatArray, dt: float) -> None:
        """The foot is late: slow the DCM's reference down, and lead the foot along with the DCM.

        Args:
            before: (3,) the reference a period ago [m].
            dcm: (3,) its DCM, were its arms nominal [m].
            dt: since then [s].
        """
        guard, step, time = self._guard, self._step, self._time - self._transfer
        assert step is not None
        self.vrp[:2] = guard.late_vrp(before)[:2]
        self.dcm[:2] = before[:2] + self._omega * dt * (before[:2] - self.vrp[:2])
        foothold = guard.late_foothold(dcm)
        if self.foothold is not None and abs(foothold - self.foothold.position).max() > FOLLOWED:
            sole = SolePose(foothold, step.sole.rotation)
            self._trajectory.follow(time, foothold)
            self.foothold = sole
            self._step = replace(step, sole=sole)

    def _touched(self, state: RobotState, foot: int) -> bool:
        step, passed = self._step, self._time - self._transfer
        assert step is not None
        if passed < self._earliest * step.swing_duration:
            return False
        felt = state.foot_forces[foot] > self._table.touchdown_force
        return bool(felt) or passed > step.swing_duration + self._table.latest_touchdown

    def _end_swing(self, state: RobotState) -> None:
        step = self._step
        assert step is not None
        self.source.ended(step)
        self._landed, self.swinging, self._sways = step.foot, None, False
        on_time = self._transfer + step.swing_duration
        self._early = max(0.0, on_time - self._time)
        self._begin_transfer(state, self.source.upcoming(sole_poses(state)))

    def _feet(self) -> None:
        """Who may push, and where the swinging foot shall be."""
        self.load[:] = 1.0
        if self.swinging is not None:
            self.load[self.swinging] = 0.0
            self.swing = self._trajectory.at(self._time - self._transfer)
            return
        ramp = self._table.loading_duration
        if self._landed is not None:
            self.load[self._landed] = min(1.0, self._time / ramp)
        if self._step is not None:
            foot = self._step.foot
            self.load[foot] = min(self.load[foot], max(0.0, (self._transfer - self._time) / ramp))


def sole_poses(state: RobotState) -> list[SolePose]:
    """Left and right, as they are."""
    return [SolePose(state.sole_positions_in_odom[i], state.sole_rotations_in_odom[i]) for i in (LEFT, RIGHT)]
