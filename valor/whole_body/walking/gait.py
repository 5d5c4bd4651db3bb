"""Gait: transfer of weight, swing, transfer, swing, … until there are no more steps, then rest.

    at rest ─► transfer ─► swing ─► transfer ─► swing ─► … ─► last transfer ─► at rest

Steps are requested when a transfer starts, and the DCM is planned from its reference over the measured soles: a plan
may change with every step, and a foot at another position is no error any more. Later steps affect the DCM by e^{−ωt};
three steps ahead are enough.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, inf, sqrt

import numpy as np

from valor.common.arrays import FloatArray
from valor.control.state import RobotState
from valor.control.steps import SolePose, Step, StepSource
from valor.control.tuning_tables import Tuning
from valor.robot.description import RobotDescription
from valor.robot.footsteps import LEFT, RIGHT
from valor.robot.motion_tables import Walking
from valor.robot.size import ESCHER
from valor.whole_body.balance.reference import at_frequency
from valor.whole_body.walking.dcm_plan import DcmPlan
from valor.whole_body.walking.footsteps import RecoverySteps
from valor.whole_body.walking.frequency import NaturalFrequency, VaryingFrequency
from valor.whole_body.walking.step_guard import Situation, StepGuard
from valor.whole_body.walking.swing import SwingPoint, SwingTrajectory

AHEAD = 3  # Steps planned
HIPS_AHEAD = 0.05  # Hips ahead of the middle of the feet when the rear foot lifts, for ESCHER's leg [m]
QUICK_DEPTH, UNHURRIED = 0.5, 3.0  # Fraction of the depth at full speed; rate of its growth below that
SHORTEST_PIECE = 0.01  # Shortest piece of a plan [s]
FOLLOWED = 1e-3  # Smallest move of a late foot's foothold [m]
MOST_LOWERED = 0.12  # Largest lowering of the CoM, for ESCHER's leg [m]
EARLY = 0.15  # Fraction of the swing before which a foot found in the air cannot have landed
LOWERING = 8.0  # Rate of lowering for a step longer than planned [1/s]


class Gait:
    """References of DCM and feet while the robot steps."""

    def __init__(self, robot: RobotDescription, omega: float, com_height: float) -> None:
        self._table, self._nominal = robot.tables.walking, omega
        self._varies = robot.read(Tuning).whole_body.natural_frequency == "varying"
        self._frequency = NaturalFrequency(omega)
        feet = robot.tables.feet
        self._centres = [np.array(((foot.heel + foot.toe) / 2.0, 0.0, 0.0)) for foot in (feet.left, feet.right)]
        self._toes = (feet.left.toe, feet.right.toe)
        self._height, self._gravity = np.array((0.0, 0.0, com_height)), omega * omega * com_height
        self.source: StepSource  # source of the steps
        self._step: Step | None = None
        self._plan: DcmPlan
        self._guard = StepGuard(robot)
        self._trajectory: SwingTrajectory
        self._time = 0.0  # since the transfer began [s]
        self._transfer = 0.0  # its duration [s]
        self._resting = 0  # piece of the plan with the VRP over the next stance foot
        self._early = 0.0  # by how much the last foot was early [s]
        self._landed: int | None = None
        self._urgent = False  # whether an early foot is followed by the next at once
        self._sways = True  # whether the robot sways before the first step
        self._earliest = 0.0  # fraction of the swing before which landing is ignored
        size = robot.tables.size.leg / ESCHER.leg
        self._hips_ahead, self._most_lowered = size * HIPS_AHEAD, size * MOST_LOWERED
        # Feet wider apart than ESCHER's are below wider hips: no leg leans for that.
        self._wide = max(0.0, self._table.step_width - size * Walking().step_width)
        self._disturbance = robot.read(Tuning).disturbance
        self._planned_lowering = 0.0  # of the CoM over the stance foot [m]
        self._lower = self._lowered = 0.0  # additional target and actual lowering for an adjusted step [m]
        self.active = False  # whether it steps; the other attributes are valid only then
        self.dcm, self.vrp = np.zeros(3), np.zeros(3)  # references in odom for nominal arms [m]
        self.omega, self.omega_dot = omega, 0.0  # ω [1/s] and ω̇ [1/s²] of both, nominal at rest
        self._com_height = com_height  # of the CoM that they lead, in odom [m]
        self.load = np.ones(2)  # (2,) permitted load of each foot, from 0 (none) to 1 (unlimited)
        self.swinging: int | None = None  # foot in the air, or None
        self.swing: SwingPoint  # its reference
        self.foothold: SolePose | None = None  # its target, or None

    def start(
        self, state: RobotState, source: StepSource, dcm: FloatArray, vrp: FloatArray, *, urgent: bool = False
    ) -> bool:
        """Start if the source has steps, from (3,) references of standing [m]; ``urgent``: without swaying first."""
        steps = source.upcoming(sole_poses(state))
        if not steps:
            return False
        self.active = True
        self.dcm, self.vrp, self._com_height = dcm, vrp, float(dcm[2])
        self._early, self._landed = 0.0, None
        self.source = source
        self._sways, self._urgent = not urgent, urgent
        self._begin_transfer(state, steps, 0.0 if urgent else self._table.first_transfer_duration)
        return True

    def recover(
        self, state: RobotState, source: RecoverySteps, dcm: FloatArray, vrp: FloatArray, velocity: FloatArray
    ) -> None:
        """Start stepping at once, with the foot for which this step and the next cost least.

        (3,) ``dcm`` and its ``velocity`` measured, ``vrp`` reference, for nominal arms [m, m/s].
        """
        if self.active:
            self.source.rested()
        soles, table = sole_poses(state), self._disturbance
        pushed = dcm + table.look_ahead * velocity  # where the push, if it goes on, will have moved it

        def begin(foot: int) -> float:
            source.lead(foot)
            steps = source.upcoming(soles)
            self.start(state, source, dcm, vrp, urgent=True)
            landing, centre = self._plan.at_end(self._resting + 2)
            second = Situation(
                steps[1], steps[0].sole, soles[steps[1].foot], centre, np.zeros(3), landing,
                steps[1].swing_duration, least=table.shortest_swing, transfer=steps[2].transfer_duration,
                omega=self._guard.situation.omega,
            )  # fmt: skip
            return self._guard.cost(pushed - self._plan.at(0.0)[0], soles[foot], second)

        begin(min((LEFT, RIGHT), key=begin))

    def catch(self, state: RobotState, source: RecoverySteps, foot: int, dcm: FloatArray) -> None:
        """Start with a foot in the air, and lower it where the DCM needs it; ``dcm`` (3,) as in ``recover``."""
        source.lead(foot)
        soles = sole_poses(state)
        step, *others = source.upcoming(soles)
        step = replace(step, transfer_duration=SHORTEST_PIECE)  # the weight is over the other foot already
        self.active, self.source = True, source
        self.dcm, self.vrp, self._com_height = dcm, self._over(soles[1 - foot], 1 - foot), float(dcm[2])
        self._early, self._landed, self._sways, self._urgent = 0.0, None, False, True
        self._begin_transfer(state, (step, *others))
        self._time = self._transfer
        self._begin_swing(state, step)
        self._earliest = EARLY

    @property
    def stepping(self) -> int | None:
        """Foot of the step under way, in the air or before; None at rest, or while swaying from rest."""
        return None if self._step is None or self._sways else self._step.foot

    @property
    def resting(self) -> bool:
        """True if no step is under way or to come."""
        return self._step is None

    def stop(self) -> None:
        """End the gait at once."""
        self.active = False
        self.omega, self.omega_dot = self._nominal, 0.0
        self.swinging = self.foothold = self._step = None
        self.load[:] = 1.0

    @property
    def _growth(self) -> float:
        """Rate at which the DCM diverges from the VRP [1/s]."""
        return self.omega - self.omega_dot / self.omega

    def update(self, state: RobotState, shift: FloatArray, dt: float) -> None:
        """Advance one period of ``dt`` [s].

        ``shift`` (3,) is the DCM's due to arms that are not nominal, and to angular momentum, which will stop [m].
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
            self._end_swing(state, shift)
        before = self.dcm
        self.dcm, self.vrp = self._plan.at(self._time)
        self.omega, self.omega_dot = self._plan.omega, self._plan.omega_dot
        dcm = self._measured(state, shift)
        self._sink(dt)
        if self._step is not None:
            if self.swinging is not None and self._time > self._transfer + self._step.swing_duration:
                self._wait(before, dcm, dt)
            else:
                self._give_way(state, dcm, self._step)
        self._com_height += self.omega * dt * (float(self.dcm[2]) - self._com_height)
        self._feet()

    def _begin_transfer(self, state: RobotState, steps: Sequence[Step], shortest: float = 0.0) -> None:
        """Start the transfer to the next step, or to rest."""
        self._time = self._lower = self._lowered = 0.0
        if steps:
            self._step, self.foothold = steps[0], steps[0].sole
            self._transfer = max(shortest, steps[0].transfer_duration) + self._early
            self.source.began(steps[0])
        else:
            self._step = self.foothold = None
            self._transfer = self._table.last_transfer_duration + self._early
        soles = sole_poses(state)
        self._plan_dcm(state, soles, steps)
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
                omega=self._frequency.over(0.0, touchdown)[0],
            )

    def _plan_dcm(self, state: RobotState, soles: list[SolePose], steps: Sequence[Step]) -> None:
        """Plan the DCM with the VRP's knots over present and coming soles."""
        begin = self._over_cop() if self._varies else self.vrp
        durations, knots, points = [], [begin], []  # points: times and heights of the CoM in the middle of transfers
        early = self._early if self._early > SHORTEST_PIECE else 0.0
        if early:  # the VRP stays for its planned duration
            durations.append(early)
            knots.append(begin)
        first = len(durations)
        poses = list(soles)
        lowered = 0.0  # lowering for the step before
        for i, step in enumerate(steps[:AHEAD]):
            stance = self._over(poses[1 - step.foot], 1 - step.foot)
            before, lowered = lowered, self._lowering(poses[1 - step.foot], step.sole)
            lower = max(before, lowered, self._lowering(poses[0], poses[1]) if i == 0 else 0.0)
            if i == 0:
                self._planned_lowering = lower
            transfer = self._transfer - early if i == 0 else step.transfer_duration
            if not self._varies:
                stance[2] -= lower
            elif i > 0:
                points.append((sum(durations) + 0.5 * transfer, self._between(poses)[2] - before))
            if i == 0 and self._sways:  # from rest: sway aside first
                durations += [0.5 * transfer, 0.5 * transfer]
                knots += [0.5 * (begin + stance), stance]
            else:
                durations.append(transfer)
                knots.append(stance)
            durations.append(step.swing_duration)
            knots.append(stance)
            poses[step.foot] = step.sole
        rest = self._between(poses)
        if steps:
            durations.append(self._table.last_transfer_duration)
            knots.append(rest)
        else:
            half = 0.5 * (self._transfer - early)
            durations += [half, half]
            knots += [0.5 * (begin + rest), rest]
        self._resting = first + (2 if self._sways else 1)
        over_stance, sway = slice(self._resting, self._resting + 2), slice(first + 1, first + 2)
        if self._sways or not steps:
            giving, most = sway, inf
        else:  # over the next stance within its sole; later steps correct the rest
            giving, most = over_stance, 0.0 if self._landed is None else self._disturbance.giving
        dcm = self.dcm
        if self._varies:
            self._vary(durations, np.array(knots), [*points, (sum(durations), rest[2] - lowered)])
            dcm = at_frequency(dcm, state.com_in_odom, self.omega / self._frequency.at(0.0)[0])
        self._plan = DcmPlan(self._frequency, durations, np.array(knots), dcm, giving, most=most)
        if steps:  # wait for a late foot
            self._plan.hold(self._resting)

    def _over_cop(self) -> FloatArray:
        """(3,) VRP raised to the nominal CoM height above its CoP, in odom [m]."""
        begin: FloatArray = self.vrp + self._height
        begin[2] -= self._gravity / (self.omega * self._growth)
        return begin

    def _vary(self, durations: list[float], knots: FloatArray, points: list[tuple[float, float]]) -> None:
        """Plan the CoM's height through points (time [s], height [m]) at the CoPs below (n, 3) knots, and ω with it."""
        above = self._com_height
        begin = (
            above,
            self.omega * (float(self.dcm[2]) - above),
            self.omega * self._growth * (above - float(self.vrp[2])),
        )
        ground = knots[:, 2] - self._height[2]
        self._frequency = VaryingFrequency(self._gravity, np.cumsum((0.0, *durations)), ground, points, begin)

    def _between(self, poses: Sequence[SolePose]) -> FloatArray:
        """(3,) VRP over the middle of both soles, in odom [m]."""
        return 0.5 * (self._over(poses[0], 0) + self._over(poses[1], 1))

    def _over(self, sole: SolePose, foot: int) -> FloatArray:
        """(3,) VRP over the middle of a sole, in odom [m]."""
        place: FloatArray = sole.position + sole.rotation @ self._centres[foot] + self._height
        return place

    def _depth(self, duration: float) -> float:
        """Depth of a swing below its foothold [m], less for a fast one."""
        table = self._table
        ease = (duration - table.fast_swing_duration) / (table.swing_duration - table.fast_swing_duration)
        return table.touchdown_depth * min(1.0, max(QUICK_DEPTH, UNHURRIED * ease))

    def _lowering(self, one: SolePose, other: SolePose) -> float:
        """Lowering of the CoM that keeps the legs within their reach; in transfer the hips are midway [m]."""
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
        """Adjust foothold and time of the step to the DCM."""
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
            self.dcm[:2], self.vrp[:2] = (
                guard.reference(left)[:2],
                guard.situation.centre[:2],
            )  # heights stay as planned

    def _sink(self, dt: float) -> None:
        """Lower the CoM further than planned for an adjusted step, DCM and VRP consistently."""
        rate = LOWERING * (self._lower - self._lowered)
        self._lowered += rate * dt
        self.dcm[2] -= self._lowered
        self.vrp[2] -= self._lowered - rate / self._growth

    def _wait(self, before: FloatArray, dcm: FloatArray, dt: float) -> None:
        """Slow the DCM reference, last at ``before``, while the foot is late, and move the foot with the DCM."""
        guard, step, time = self._guard, self._step, self._time - self._transfer
        assert step is not None
        self.vrp[:2] = guard.late_vrp(before)[:2]
        self.dcm[:2] = before[:2] + self._growth * dt * (before[:2] - self.vrp[:2])
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

    def _end_swing(self, state: RobotState, shift: FloatArray) -> None:
        step, table = self._step, self._disturbance
        assert step is not None
        left = max(0.0, self._transfer + step.swing_duration - self._time)
        foot = state.sole_positions_in_odom[step.foot]
        pushed = self._guard.missed(left, foot, self._measured(state, shift)) > table.recovered
        self.source.ended(step)
        self._landed, self.swinging, self._sways = step.foot, None, False
        self._early = 0.0 if self._urgent or pushed else left
        steps = self.source.upcoming(sole_poses(state))
        if pushed and steps:  # the next step at once
            transfer = min(steps[0].transfer_duration, table.recovery_transfer_duration)
            swing = min(steps[0].swing_duration, table.recovery_swing_duration)
            steps = [replace(steps[0], transfer_duration=transfer, swing_duration=swing), *steps[1:]]
        self._begin_transfer(state, steps)

    def _measured(self, state: RobotState, shift: FloatArray) -> FloatArray:
        """(3,) DCM at the reference's ω, without ``shift``, in odom [m]."""
        dcm: FloatArray = at_frequency(state.dcm_in_odom, state.com_in_odom, self._nominal / self.omega) - shift
        return dcm

    def _feet(self) -> None:
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
    """Return the estimated soles, left and right."""
    return [SolePose(state.sole_positions_in_odom[i], state.sole_rotations_in_odom[i]) for i in (LEFT, RIGHT)]
