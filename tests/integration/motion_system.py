"""The Motion System as it runs, and a client beside it: what it reports is kept, what it is asked for answered."""

from collections.abc import Callable, Mapping

import numpy as np

from harness.instance import RunningInstance
from harness.waiting import some, wait_until
from valor.common import messages, topics
from valor.common.behaviors import Behavior
from valor.common.messages import BehaviorReply, BehaviorRequest, GroundTruth, MotionState, StepStatus, VelocityCommand
from valor.common.topics import BEHAVIOR, FOOTSTEP_PLAN, GROUND_TRUTH, JOINT_SETPOINTS, MOTION_STATE, MOTOR, PUSH

STANDING = 0.7  # the pelvis of a standing robot is higher [m]


class MotionSystem:
    """Comms Manager and Motion Manager of an instance, and what a client can see of them and ask for."""

    def __init__(self, instance: RunningInstance) -> None:
        self.instance = instance
        node = instance.node()
        self._states = MOTION_STATE.subscriber(node, queue=20_000)
        self._truth = GROUND_TRUTH.subscriber(node)
        self._rejections = topics.REJECTION.subscriber(node, queue=1000)
        self._statistics = topics.STATISTICS["motion_manager"].subscriber(node)
        self.motors = MOTOR.subscriber(node)
        self._setpoints = JOINT_SETPOINTS.publisher(node)
        self._velocity = topics.VELOCITY.publisher(node)
        self._behavior = BEHAVIOR.client(node)
        self._footsteps = FOOTSTEP_PLAN.client(node)
        self._push = PUSH.client(node)
        self._steps = topics.STEP_STATUS.subscriber(node, queue=1000)
        self.history: list[MotionState] = []
        self.rejections: list[messages.Rejection] = []
        self.statuses: list[StepStatus] = []
        self._ground_truth: GroundTruth | None = None
        instance.start("comms_manager")
        instance.start("motion_manager")
        instance.wait_ready("motion_manager")

    def look(self) -> MotionState | None:
        """The newest MotionState; all are kept in ``history``."""
        self.history += [received.message for received in self._states.drain()]
        self.rejections += [received.message for received in self._rejections.drain()]
        if (truth := self._truth.latest()) is not None:
            self._ground_truth = truth.message
        return self.history[-1] if self.history else None

    def place(self) -> np.ndarray:
        """(3,) true position of the pelvis [m]."""
        self._ground_truth = None

        def known() -> GroundTruth | None:
            self.look()
            return self._ground_truth

        position: np.ndarray = wait_until(known, 10.0, "the simulator's truth").pelvis_position_in_world
        return position

    @property
    def height(self) -> float:
        return float(self.place()[2])

    def counts_at_least(self, rejected: int) -> bool:
        """Return whether its newest statistics, which come once a second, have so many refusals."""
        reported = self._statistics.latest()
        return reported is not None and reported.message.rejected >= rejected

    def wait(self, condition: Callable[[MotionState], bool], what: str, timeout: float = 60.0) -> MotionState:
        def seen() -> MotionState | None:
            state = self.look()
            return state if state is not None and condition(state) else None

        return wait_until(seen, timeout, what)

    def wait_behavior(self, behavior: Behavior, timeout: float = 60.0) -> MotionState:
        return self.wait(lambda state: state.behavior == behavior, f"behavior {behavior}", timeout)

    def pass_time(self, seconds: float) -> MotionState:
        until = self.now() + round(seconds * 1e9)
        return self.wait(lambda state: state.time >= until, f"{seconds} s of robot time")

    def now(self) -> int:
        """Robot time [ns]."""
        state = self.look()
        return 0 if state is None else state.time

    def request(self, behavior: str) -> BehaviorReply:
        return self._behavior.call(BehaviorRequest(behavior=behavior), timeout=10.0)

    def go(self, behavior: Behavior) -> MotionState:
        """Ask until it is accepted: Stand is, once Stand Prep has finished."""
        wait_until(lambda: self.request(behavior).accepted, 60.0, f"{behavior} accepted", period=0.1)
        return self.wait_behavior(behavior)

    def stand(self) -> MotionState:
        """Bring the robot to Stand. A robot on the floor gets another world, in which it begins on its feet."""
        if self.pass_time(0.1).behavior == Behavior.FALL:
            self.go(Behavior.FREEZE)
        if self.pass_time(0.1).behavior == Behavior.FREEZE:
            self.go(Behavior.STAND_PREP)
        if self.height < STANDING:
            before = self.now()
            self.instance.kill("comms_manager")
            self.instance.start("comms_manager")
            self.wait(lambda state: state.time < before and state.behavior == Behavior.FREEZE, "another world")
            self.go(Behavior.STAND_PREP)
        return self.go(Behavior.STAND)

    def send(self, setpoints: Mapping[str, float], age: float = 0.0, **changes: object) -> None:
        """One message of set-points, as of now."""
        message = messages.JointSetpoints(
            time=self.now() - round(age * 1e9), names=list(setpoints),
            position=np.array(list(setpoints.values()), dtype=float), velocity=np.zeros(len(setpoints)),
            acceleration=np.zeros(len(setpoints)),
        )  # fmt: skip
        for name, value in changes.items():
            setattr(message, name, value)
        self._setpoints.publish(message)

    def walk(self, forward: float, seconds: float) -> None:
        """Request a velocity [m/s] for a duration [robot time, s]."""
        until = self.now() + round(seconds * 1e9)

        def over() -> bool:
            self._velocity.publish(VelocityCommand(self.now(), forward, 0.0, 0.0))
            state = some(self.look())
            assert state.behavior == Behavior.WALK, state.reason
            return state.time >= until

        wait_until(over, 120.0, f"{seconds} s of walking", period=0.02)

    def plan(self, steps: list[messages.Footstep]) -> messages.FootstepPlanReply:
        return self._footsteps.call(messages.FootstepPlanRequest(steps=steps), timeout=10.0)

    def status(self) -> StepStatus | None:
        """Latest StepStatus; ``statuses`` keeps all."""
        self.statuses += [received.message for received in self._steps.drain()]
        return self.statuses[-1] if self.statuses else None

    def walk_on_one_foot(self, seconds: float) -> None:
        """Walk ahead at 0.3 m/s, at least so long [robot time], until a foot is in the air."""
        self.go(Behavior.WALK)
        until = self.now() + round(seconds * 1e9)

        def step() -> bool:
            self._velocity.publish(VelocityCommand(self.now(), 0.3, 0.0, 0.0))
            state = self.look()
            return state is not None and state.time > until and state.contacts.sum() == 1

        wait_until(step, 60.0, "a foot in the air", period=0.02)

    def lead(self, setpoints: Mapping[str, float], until: Callable[[MotionState], bool], what: str) -> MotionState:
        """Stream set-points until something is so."""

        def step() -> MotionState | None:
            self.send(setpoints)
            state = self.look()
            return state if state is not None and until(state) else None

        return wait_until(step, 60.0, what, period=0.004)

    def refused(self, reason: str, **message: object) -> None:
        """Send set-points again and again until they are seen to be refused for a reason."""

        def step() -> bool:
            self.send(message.get("setpoints", {"neck_yaw": 0.1}), **message.get("changes", {}))  # type: ignore[arg-type]
            self.look()
            return any(reason in rejection.reason for rejection in self.rejections)

        wait_until(step, 20.0, f"a rejection with {reason!r}; seen: {[r.reason for r in self.rejections]}")

    def push(self, impulse: tuple[float, float, float]) -> None:
        reply = self._push.call(messages.PushRequest(impulse_in_world=np.array(impulse), duration=0.1), timeout=10.0)
        assert reply.accepted, reply.reason

    def forget(self) -> None:
        """What was seen so far, but for the newest MotionState."""
        self.look()
        self.history, self.rejections = self.history[-1:], []

    def behaviors(self) -> list[str]:
        self.look()
        seen: list[str] = []
        for state in self.history:
            if not seen or seen[-1] != state.behavior:
                seen.append(state.behavior)
        return seen
