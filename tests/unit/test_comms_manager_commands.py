"""Which Motor the devices obey: each whole or not at all; and who has the joints once none comes any more."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness import motion_states
from harness.bifrost_network import BifrostNetwork, until
from harness.still_robot import PERIOD, ROBOT, N, Robot
from valor.common.behaviors import REFLEX, Reaction
from valor.common.messages import JointMode, Motor
from valor.common.topics import MOTOR
from valor.comms_manager.command_arbiter import BehaviorLatch, CommandArbiter
from valor.comms_manager.commands import ABSENCE, AT_ONCE, COMMAND_TIMEOUT, MISSES_TO_SILENCE, Commands
from valor.valorctl.instance.ros_domain import daemon_ports
from valor.whole_body.reflex import BalanceReflex

FIRST = 1000  # state that the world begins with
OLDEST = round(COMMAND_TIMEOUT * 1e9) // PERIOD  # periods ago, of a state that may be answered still
VECTORS = ("position", "velocity", "effort", "stiffness", "damping")
SOON = 0.02  # for what does not come [s]
LONG = 10.0  # for what does [s]
STANDING = Robot()
LIMP = {"mode": np.full(N, JointMode.FORCE, dtype=np.uint8), "stiffness": np.zeros(N)}


def motor(answers: int, **changes: Any) -> Motor:
    given: dict[str, Any] = {"mode": JointMode.IMPEDANCE, "stiffness": np.ones(N), "damping": np.ones(N), "writer": 5}
    return motion_states.motor(ROBOT, proprioceptor_sequence=answers, **(given | changes))


@pytest.fixture(scope="module")
def net(tmp_path_factory: pytest.TempPathFactory, ros_domain: int) -> Iterator[BifrostNetwork]:
    made = BifrostNetwork(tmp_path_factory.mktemp("network"), daemon_ports(ros_domain))
    made.start_daemon()
    yield made
    made.close()


class Devices:
    """What the Comms Manager has of them: a state each period; and a Motion Manager that sends what the test wants."""

    def __init__(self, net: BifrostNetwork, reflex: BalanceReflex, file: Path) -> None:
        self._speaker, self._listener = net.node("motion_manager"), net.node("comms_manager")
        self._publisher = MOTOR.publisher(self._speaker)
        subscriber = MOTOR.subscriber(self._listener, queue=AT_ONCE)
        self.latch = BehaviorLatch(file, 1)
        self.commands = Commands(subscriber, ROBOT, CommandArbiter(reflex, self.latch))
        self._robot = STANDING
        self.sequence = FIRST - 1
        self._subscriber = subscriber
        until(self._connected, "they know each other")

    def _connected(self) -> bool:
        self._publisher.publish(motor(0, behavior=REFLEX))  # is passed over, if it comes later
        return self._subscriber.receive(timeout=SOON) is not None

    def measure(self, periods: int = 1, demand: Reaction = Reaction.KEEP_BALANCE, **changes: Any) -> None:
        self.sequence += periods
        self._robot.time, self._robot.sequence = self.sequence * PERIOD, self.sequence
        self.commands.measured(self._robot.proprioceptor(**changes), demand)

    def say(self, **changes: Any) -> None:
        self._publisher.publish(motor(**{"answers": self.sequence} | changes))

    def hear(self, **changes: Any) -> bool:
        """The same, and it is taken in; whether it is in force now."""
        commands = self.commands
        admitted, before = commands.arbiter.admitted, commands.arbiter.admitted + commands.rejected
        self.say(**changes)

        def considered() -> bool:
            commands.take()
            return commands.arbiter.admitted + commands.rejected > before

        until(considered, "a Motor is considered")
        assert commands.arbiter.admitted + commands.rejected == before + 1
        return commands.arbiter.admitted > admitted

    def leave(self) -> None:
        self._speaker.close()

        def nobody() -> bool:
            self.commands.take()
            return not self._subscriber.publishers

        until(nobody, "nobody publishes Motor")

    def close(self) -> None:
        self._speaker.close()
        self._listener.close()
        self.latch.close()


@pytest.fixture(scope="module")
def reflex() -> BalanceReflex:
    return BalanceReflex(ROBOT)


@pytest.fixture
def devices(net: BifrostNetwork, reflex: BalanceReflex, tmp_path: Path) -> Iterator[Devices]:
    reflex.done = True
    made = Devices(net, reflex, tmp_path / "behavior.json")
    made.measure()
    yield made
    made.close()


def broken(name: str, value: float) -> dict[str, Any]:
    vector = getattr(motor(FIRST), name).copy()
    vector[N // 2] = value
    return {name: vector}


UNSOUND = {
    **{f"{name} is short": ({name: getattr(motor(0), name)[1:]}, "wrong length") for name in ("mode", *VECTORS)},
    **{f"{name} is long": ({name: np.ones(N + 1)}, "wrong length") for name in VECTORS},
    **{f"{name} is {x}": (broken(name, x), "not finite") for name in VECTORS for x in (np.nan, np.inf, -np.inf)},
    "mode": (broken("mode", max(JointMode) + 1), "unknown mode"),
    "stiffness is negative": (broken("stiffness", -1e-9), "negative gain"),
    "damping is negative": (broken("damping", -1e-9), "negative gain"),
    "of no state yet": ({"answers": FIRST + 1}, "answers no state of this run"),
    "of the world before": ({"answers": FIRST - 1}, "answers no state of this run"),
    "of an older Motion Manager": ({"writer": 4}, "of an older Motion Manager"),
}


def test_an_unsound_motor_is_rejected_whole_and_reported_once(
    devices: Devices, caplog: pytest.LogCaptureFixture
) -> None:
    assert devices.hear(behavior="walk")
    commands, obeyed = devices.commands, devices.commands.arbiter.motor
    for refused, (name, (changes, _)) in enumerate(UNSOUND.items(), 1):
        assert not devices.hear(**({"behavior": "freeze"} | changes)), name
        assert (commands.arbiter.motor, commands.arbiter.admitted, commands.rejected) == (obeyed, 1, refused), name
        assert devices.latch.behavior == "walk"
    reported = [record.getMessage() for record in caplog.records]
    kinds = {reason for _, reason in UNSOUND.values()}
    assert all(sum(f"Motor from motion_manager rejected: {kind}" in line for line in reported) == 1 for kind in kinds)
    assert len(reported) == len(kinds)


def test_what_keeps_all_rules_to_the_edge_is_executed(devices: Devices) -> None:
    modes = np.full(N, JointMode.OFF, dtype=np.uint8)
    modes[:4] = list(JointMode)
    assert devices.hear(mode=modes, stiffness=np.zeros(N), damping=np.zeros(N))
    assert devices.hear(), "twice an answer to the same state"
    assert devices.hear(writer=6), "a younger Motion Manager"
    assert not devices.hear(writer=5) and devices.commands.answered and devices.latch.behavior == "stand"


def test_an_answer_may_be_so_old_and_never_older_than_the_one_before(devices: Devices) -> None:
    commands = devices.commands
    devices.measure(OLDEST + 5)
    assert devices.hear(answers=FIRST), "the first may be of any age: the world has waited for it"
    assert commands.age == OLDEST + 5 and not commands.answered
    assert not devices.hear(answers=devices.sequence - OLDEST - 1) and devices.hear(answers=devices.sequence - OLDEST)
    assert not devices.hear(answers=devices.sequence - OLDEST - 1), "older than the one in force"
    assert devices.hear()
    assert commands.age == 0 and commands.answered


def test_before_the_first_motor_nothing_is_silent(devices: Devices) -> None:
    commands = devices.commands
    devices.measure(2 * OLDEST)
    assert not any(commands.wait(SOON) for _ in range(2 * MISSES_TO_SILENCE))
    devices.leave()
    devices.measure(2 * ABSENCE)
    assert not commands.wait(SOON)
    assert (commands.arbiter.abandoned, commands.arbiter.silent, commands.answered, commands.waits_timed_out) == (
        False,
    ) * 3 + (0,)


@pytest.mark.parametrize(("said", "limp"), [({}, False), (LIMP, True)], ids=["led", "limp"])
def test_who_sends_nothing_is_silent_until_the_next_word(devices: Devices, said: dict[str, Any], limp: bool) -> None:
    commands = devices.commands
    assert devices.hear(**said)
    devices.measure(OLDEST)
    assert not commands.arbiter.silent
    devices.measure()
    assert (commands.arbiter.abandoned, commands.arbiter.silent, commands.arbiter.limp) == (True, True, limp)
    assert not devices.hear(stiffness=-np.ones(N))
    assert commands.arbiter.silent
    assert devices.hear()
    assert (commands.arbiter.abandoned, commands.arbiter.silent, commands.arbiter.limp) == (False, False, False)
    devices.measure(OLDEST)
    assert not commands.arbiter.silent, "the time counts from the last that was obeyed"
    devices.measure()
    assert commands.arbiter.silent


def test_no_motor_is_taken_before_the_first_state(net: BifrostNetwork, reflex: BalanceReflex, tmp_path: Path) -> None:
    devices = Devices(net, reflex, tmp_path / "behavior.json")
    assert not devices.hear(answers=0) and devices.commands.arbiter.motor is None
    devices.close()


def test_an_absent_motion_manager_is_not_waited_for(devices: Devices) -> None:
    commands = devices.commands
    devices.say(behavior=REFLEX)
    assert devices.hear()
    assert (commands.arbiter.admitted, commands.rejected) == (1, 0), "a Motor of the reflex is ignored"
    devices.leave()
    devices.measure(ABSENCE)
    assert not commands.arbiter.silent, "it may have been the last of many, and more wait"
    devices.measure()
    assert commands.arbiter.silent


def test_a_wait_ends_with_the_answer_and_misses_are_silence(devices: Devices, caplog: pytest.LogCaptureFixture) -> None:
    commands = devices.commands
    devices.say()
    assert commands.wait(LONG)
    for misses in range(1, MISSES_TO_SILENCE):
        devices.measure()
        assert not commands.wait(SOON) and commands.waits_timed_out == misses
    assert commands.wait(SOON, age=MISSES_TO_SILENCE - 1), "one that old will do"
    for _ in range(MISSES_TO_SILENCE - 1):
        assert not commands.wait(SOON)
    assert not commands.arbiter.silent, "not in a row"
    for _ in range(3):
        assert not commands.wait(SOON) and commands.arbiter.silent
    assert caplog.text.count("waits of") == 1, "it is told once"
    devices.say()
    assert commands.wait(LONG) and not commands.wait(SOON, age=-1) and not commands.arbiter.silent


def test_who_listens_takes_what_is_there_and_counts_no_miss(devices: Devices) -> None:
    commands = devices.commands
    devices.say()
    commands.listen(LONG)
    assert commands.arbiter.admitted == 1
    for _ in range(2 * MISSES_TO_SILENCE):
        commands.listen(SOON)
    assert (commands.arbiter.admitted, commands.waits_timed_out, commands.arbiter.silent) == (1, 0, False)
    for _ in range(3):
        devices.say()

    def taken() -> bool:
        commands.listen(0.0)
        return commands.arbiter.admitted == 4

    until(taken, "all are taken, without waiting")
    assert commands.drops == 0


def test_a_robot_left_walking_is_led_until_it_stands(devices: Devices, caplog: pytest.LogCaptureFixture) -> None:
    commands = devices.commands
    assert devices.hear(behavior="walk")
    devices.measure(OLDEST + 1)
    assert commands.arbiter.abandoned and not commands.arbiter.silent and commands.answered
    admitted = commands.arbiter.admitted
    devices.say(behavior="stand")  # by one that should stand aside
    while not commands.arbiter.silent:
        assert commands.arbiter.motor is not None and commands.arbiter.motor.behavior == REFLEX
        devices.measure()
        admitted += 1
        assert (commands.arbiter.admitted, commands.answered) == (admitted, True)
    assert not commands.arbiter.limp and commands.rejected == 0
    assert devices.latch.behavior == "walk"
    assert "in walk, the balance reflex brings the robot to stand" in caplog.text
    assert "the balance reflex has ended: it stands" in caplog.text
    assert "the balance reflex has ended: the joints are held" in caplog.text
    devices.measure()
    assert commands.arbiter.admitted == admitted, "nor is anything made any more"
    assert devices.hear()
    assert not commands.arbiter.silent


def test_an_error_of_the_reflex_leaves_the_joints_held(
    devices: Devices, reflex: BalanceReflex, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    commands = devices.commands
    assert devices.hear(behavior="walk")
    devices.measure(OLDEST + 1)
    led = commands.arbiter.motor
    monkeypatch.setattr(reflex, "_controller", None)
    devices.measure()
    assert "error in the balance reflex" in caplog.text
    assert (commands.arbiter.silent, commands.arbiter.limp, commands.arbiter.motor) == (True, False, led)
