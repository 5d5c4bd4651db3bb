"""No set-point moves farther between two cycles than its joint may, and each begins where the joint is led.

Over random sequences of mode changes, controller switches, trajectories, cancellations, late cycles, losses, falls and
restarts of every side, at the VRC's outlet and once more at the Motion Manager's.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from harness.examples import examples
from harness.vrc_in_process import CONTROLLERS, MODES, PERIOD, ROBOT, System
from tests.unit.test_vrc_joint_trajectory_controller import Client
from valor.common import topics
from valor.common.behaviors import Behavior, Locomotion
from valor.common.messages import BehaviorRequest, JointSetpoints, MotionState, PelvisSetpoint
from valor.robot.commanded_limits import PELVIS_NAMES
from valor.valor_ros_controller.controller_manager import Strictness
from valor.valor_ros_controller.controllers.configuration import TrajectoryControllerConfig
from valor.valor_ros_controller.controllers.joint_trajectory_controller import MOVED
from valor.valor_ros_controller.controllers.trajectory_goal import TrajectoryRequest
from valor.valor_ros_controller.trajectory.admission import check_waypoints
from valor.valor_ros_controller.trajectory.waypoints import InvalidTrajectoryError, Point
from valor.valor_ros_controller.valor_escher_hw_interface import LONGEST_STEP

ROUNDING = 1e-8  # [rad or m]
CYCLE = 2 * PERIOD * 1e-9  # [s]
UPPER_BODY = np.array([not any(name in ROBOT.tables.groups[leg] for leg in ("left_leg", "right_leg"))
                       for name in ROBOT.joints])  # fmt: skip
LEADERS = list(CONTROLLERS.of_type(TrajectoryControllerConfig))


class Watched(System):
    """The system, with an eye on every set-point."""

    def __init__(self) -> None:
        super().__init__()
        hw = self.vrc.hw
        everything = np.arange(len(hw.names))
        self._speed = dict(zip(hw.names, hw.limits(everything).fastest, strict=True))
        self._last: dict[str, tuple[int, float]] = {}
        self._led: MotionState | None = None
        self.sent = self.moved = 0
        self.goals: list[tuple[str, Client]] = []
        for topic, hear in (
            (topics.JOINT_SETPOINTS, self._joints),
            (topics.PELVIS, self._pelvis),
            (topics.MOTION_STATE, self._motion),
        ):
            self.network.topic(topic.name).heard = hear

    def _joints(self, message: JointSetpoints) -> None:
        self._check(message.time, list(message.names), message.position)

    def _pelvis(self, message: PelvisSetpoint) -> None:
        self._check(message.time, list(PELVIS_NAMES), message.position)

    def _check(self, time: int, names: list[str], position: np.ndarray) -> None:
        hw = self.vrc.hw
        self.sent += 1
        for name, there in zip(names, position.tolist(), strict=True):
            speed = self._speed[name]
            before, here = self._last.get(name, (-(2**62), 0.0))
            elapsed = (time - before) * 1e-9
            if 0.0 <= elapsed <= LONGEST_STEP:
                assert abs(there - here) <= speed * elapsed + ROUNDING, f"{name}: {here} to {there} in {elapsed} s"
                self.moved += there != here
            else:
                led = hw.commanded[hw.names.index(name)]
                # It begins where it is led, or, after a late cycle, goes on from where it was sent.
                allowed = MOVED + speed * CYCLE + ROUNDING
                late = abs(there - here) <= speed * LONGEST_STEP + ROUNDING
                assert late or abs(there - led) <= allowed, f"{name} begins at {there}; led to {led}, sent to {here}"
            self._last[name] = (time, there)

    def _motion(self, message: MotionState) -> None:
        before, self._led = self._led, message
        if before is None or message.locomotion == Locomotion.FALL or before.locomotion == Locomotion.FALL:
            return
        step = np.abs(message.joint_setpoint - before.joint_setpoint)[UPPER_BODY]
        assert (step <= ROBOT.velocity_limit[UPPER_BODY] * PERIOD * 1e-9 + ROUNDING).all()

    def restart_motion_manager(self) -> None:
        super().restart_motion_manager()
        self._led = None  # it takes the joints up where they are

    def lead(self, name: str, fractions: list[float], seconds: float, ahead: float, waited_for: bool) -> None:
        """Send a trajectory through points so far between the joints' limits, ``seconds`` apart."""
        controller = self.vrc.trajectories[name]
        limits = controller.limits
        middle, half = (limits.upper + limits.lower) / 2, (limits.upper - limits.lower) / 2
        points = [
            Point((middle + fraction * half).tolist(), [], [], [], seconds * (i + 1))
            for i, fraction in enumerate(fractions)
        ]
        try:
            waypoints = check_waypoints(limits.names, points, limits)
        except InvalidTrajectoryError:
            return
        goal = Client() if waited_for else None
        now = controller.settings
        start = max(1, self.time + round(ahead * 1e9)) if ahead else 0
        controller.submit(TrajectoryRequest(waypoints, start, now.path, now.goal, now.goal_time, goal))
        if goal:
            self.goals.append((name, goal))


leaders = st.sampled_from(LEADERS)
modes = st.sampled_from([*MODES.modes, "stand_manipulate", "manipulate", "stand", "emergency_stop"])
actions = st.one_of(
    st.tuples(st.just("mode"), modes, st.integers(0, 40)),
    st.tuples(
        st.just("goal"),
        leaders,
        st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=3),
        st.floats(0.002, 3.0),
        st.sampled_from([0.0, 0.0, 0.3, -0.2]),
        st.booleans(),
    ),
    st.tuples(st.just("cancel"), st.booleans()),
    st.tuples(st.just("switch"), st.lists(leaders, max_size=3), st.lists(leaders, max_size=3)),
    st.tuples(st.just("run"), st.integers(1, 60)),
    st.tuples(st.just("vrc late"), st.integers(1, 60)),
    st.tuples(st.just("motion manager late"), st.integers(1, 40)),
    st.tuples(st.just("restart"), st.sampled_from(["vrc", "motion_manager", "comms_manager"])),
    st.tuples(st.just("goes"), st.sampled_from([Behavior.FALL, Behavior.STAND, Behavior.SOFT_STOP])),
    st.tuples(st.just("another"), st.sampled_from([*Behavior])),
)


def do(system: Watched, kind: str, *arguments: Any) -> None:
    """One action, and two cycles."""
    motion, vrc = system.motion, system.vrc
    assert motion is not None
    if kind == "mode":
        system.ask(arguments[0])
        system.run(arguments[1])
    elif kind == "goal":
        system.lead(*arguments)
    elif kind == "cancel":
        for name, goal in system.goals:
            controller = vrc.trajectories[name]
            controller.settings = replace(controller.settings, decelerate_on_cancel=arguments[0])
            controller.cancel(goal)
        system.goals.clear()
    elif kind == "switch":
        vrc.switch.switch(arguments[0], arguments[1], Strictness.BEST_EFFORT)
    elif kind == "run":
        system.run(arguments[0])
    elif kind == "vrc late":
        system.vrc_late = True
        system.run(arguments[0])
        system.vrc_late = False
    elif kind == "motion manager late":
        system.frozen = True
        system.run(arguments[0])
        system.frozen = False
    elif kind == "restart":
        {
            "vrc": system.start_vrc,
            "motion_manager": system.restart_motion_manager,
            "comms_manager": system.restart_comms_manager,
        }[arguments[0]]()
    elif kind == "goes":
        motion.go(arguments[0], "on its own")
    else:
        motion._behavior.handle(BehaviorRequest(str(arguments[0])), "another")
    system.run(4)


@examples(15)
@given(st.lists(actions, max_size=25))
def test_no_set_point_ever_jumps(sequence: list[tuple[Any, ...]]) -> None:
    system = Watched()
    system.run(4)
    for mode in ("stand", "stand_manipulate"):
        system.ask(mode)
        system.run(30)
    assert system.sent
    for action in sequence:
        do(system, *action)
    system.run(30)


def test_the_eye_on_the_set_points_sees_them_move() -> None:
    """The test above would find nothing if nothing moved."""
    system = Watched()
    system.run(4)
    for mode in ("stand", "stand_manipulate", "manipulate"):
        system.ask(mode)
        system.run(30)
    for name in LEADERS:
        system.lead(name, [0.1], 3.0, 0.0, True)
    system.run(200)
    assert system.moved > 90 * len(ROBOT.tables.groups["left_arm"])
    assert {name for name, (time, _) in system._last.items() if time > system.time - 3 * PERIOD} >= set(PELVIS_NAMES)
