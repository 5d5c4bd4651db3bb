"""What a period consists of and who is blamed, from marks of loops whose every stage the test has set."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from valor.analysis import period_plot
from valor.analysis.errors import SignalError
from valor.analysis.lanes import Lane
from valor.analysis.period import COLLECTING, LONGER, SLEEP, TO_MOTION, WITHOUT_CORE, Periods
from valor.common.trace import Stage, Trace

PERIOD = 0.002
FIRST = 1_700_000_000_000_000  # a sequence as the Comms Manager counts


class Loop:
    """A loop that marks its stages as the test says."""

    def __init__(self, service: str) -> None:
        self.service = service
        self.now = self.cpu = 0.0
        self.rows: list[tuple[int, float, float, float]] = []

    def stage(self, stage: Stage, end: float, idle: float = 0.0, sequence: int = 0) -> None:
        """Be at a stage until a moment, of it ``idle`` seconds without the core."""
        self.cpu += end - self.now - idle
        self.now = end
        self.rows.append((stage, end, self.cpu, sequence))

    def lane(self) -> Lane:
        columns = np.array(self.rows).T
        half = len(self.rows) // 2  # in two messages
        parts = [columns[:, :half], columns[:, half:]]
        traces = [
            Trace(self.service, part[0].astype(np.uint8), *part[1:], 1e-6, 2e-6, 1e-4)  # type: ignore[call-arg]
            for part in parts
        ]
        return Lane.of(self.service, traces)


class System:
    """Comms Manager and Motion Manager in lockstep."""

    def __init__(self) -> None:
        self.comms, self.motion = Loop("comms_manager"), Loop("motion_manager")
        self.sent = 0.0
        self.count = FIRST
        self.comms.stage(Stage.ATTEND, 0.0)
        self.comms.stage(Stage.PUBLISH, 0.0, sequence=self.count)
        self.motion.stage(Stage.ATTEND, 0.0)

    def period(self, *, to_motion: float = 1e-4, control: float = 4e-4, idle: float = 0.0, physics: float = 2e-4,
               late: float = 0.0, collects: float = 0.0) -> None:  # fmt: skip
        """One period: what is not said takes as long as usual."""
        motion, comms, sent = self.motion, self.comms, self.sent
        woken = sent + to_motion
        motion.stage(Stage.AWAIT, woken)
        motion.stage(Stage.DECODE, woken + 2e-5)
        motion.stage(Stage.TAKE_COMMANDS, woken + 2e-5)
        if collects:
            motion.rows.append((Stage.COLLECT, woken + 2e-5 + collects, woken + 2e-5, 0.0))
        motion.stage(Stage.CONTROL, woken + 2e-5 + control, idle)
        motion.stage(Stage.SEND_MOTOR, woken + 3e-5 + control, sequence=self.count)
        motion.stage(Stage.SEND_STATE, woken + 6e-5 + control)
        motion.stage(Stage.ATTEND, woken + 7e-5 + control)
        comms.stage(Stage.AWAIT_MOTOR, woken + 3e-5 + control + 1e-4)
        comms.stage(Stage.PHYSICS, comms.now + physics)
        comms.stage(Stage.MEASURE, comms.now + 1e-4)
        comms.stage(Stage.ATTEND, comms.now + 5e-5)
        due = sent + PERIOD - 3e-5
        if comms.now < due:
            comms.stage(Stage.SLEEP, due)
            comms.stage(Stage.OVERSLEEP, due + late)
        self.count += 1
        comms.stage(Stage.PUBLISH, comms.now + 3e-5, sequence=self.count)
        self.sent = comms.now

    def periods(self) -> Periods:
        lanes = {"comms_manager": self.comms.lane(), "motion_manager": self.motion.lane()}
        return Periods.of(lanes, PERIOD)


def usual(count: int = 50) -> System:
    system = System()
    for _ in range(count):
        system.period()
    return system


def test_a_usual_period_is_told_part_by_part() -> None:
    periods = usual().periods()
    assert periods.length == pytest.approx(np.full(50, PERIOD))
    assert periods.factor == pytest.approx(1.0)
    assert not periods.ranking()
    medians = {segment.title: float(np.median(segment.duration)) for segment in periods.segments}
    assert medians == pytest.approx(
        {
            "Proprioceptor → Motion Manager": 1e-4,
            "motion_manager: decodes": 2e-5,
            "motion_manager: control": 4e-4,
            "motion_manager: sends Motor": 1e-5,
            "Motor → Comms Manager": 1e-4,
            "comms_manager: physics": 2e-4,
            "comms_manager: measures": 1e-4,
            "comms_manager: clock, truth, statistics": 5e-5,
            "comms_manager: sleeps until due": PERIOD - 9.8e-4 - 3e-5,
            "comms_manager: sends Proprioceptor": 3e-5,
        },
        abs=1e-9,
    )


@given(
    st.lists(
        st.fixed_dictionaries(
            {},
            optional={
                "to_motion": st.floats(1e-5, 0.02),
                "control": st.floats(1e-4, 0.02),
                "physics": st.floats(1e-5, 0.02),
                "late": st.floats(0.0, 0.02),
            },
        ),
        min_size=4,
        max_size=60,
    )
)
def test_the_parts_are_the_period_and_the_blame_is_what_was_lost(each: list[dict[str, float]]) -> None:
    system = System()
    for arguments in each:
        system.period(**arguments)
    periods = system.periods()
    assert sum(s.duration for s in periods.segments) == pytest.approx(periods.length, abs=1e-9)
    late = periods.length[periods.late]
    blamed = sum(blame.delay for blame in periods.ranking())
    assert blamed <= float(np.sum(late - PERIOD)) + 1e-9
    for segment in periods.segments:
        assert np.all(segment.without_core <= segment.duration + 1e-9)


@pytest.mark.parametrize(
    ("disturbance", "title", "cause"),
    [
        ({"control": 0.005, "idle": 0.0046}, "motion_manager: control", WITHOUT_CORE),
        ({"control": 0.005}, "motion_manager: control", LONGER),
        ({"control": 0.005, "collects": 0.0046}, "motion_manager: control", COLLECTING),
        ({"to_motion": 0.004}, TO_MOTION, LONGER),
        ({"physics": 0.003}, "comms_manager: physics", LONGER),
        ({"late": 0.004}, "comms_manager: wakes after that", WITHOUT_CORE),
    ],
)
def test_whoever_made_the_world_wait_is_named(disturbance: dict[str, float], title: str, cause: str) -> None:
    system = usual()
    system.period(**disturbance)
    for _ in range(30):
        system.period()
    periods = system.periods()
    worst = periods.ranking()[0]
    assert (worst.title, worst.cause, worst.periods) == (title, cause, 1)
    assert worst.delay == pytest.approx(periods.length.max() - PERIOD, rel=0.02)
    assert periods.example(100) == 50
    assert periods.length[periods.example(50)] == pytest.approx(PERIOD)


def test_whoever_worked_meanwhile_is_named() -> None:
    system = usual()
    began = system.sent
    system.period(to_motion=0.004)
    recorder = Loop("bag_recorder")
    recorder.stage(Stage.REST, 0.001)
    recorder.stage(Stage.REST, began + 0.001)
    recorder.stage(Stage.WRITE, began + 0.003)
    lanes = {"comms_manager": system.comms.lane(), "motion_manager": system.motion.lane()}
    worst = Periods.of(lanes | {"bag_recorder": recorder.lane()}, PERIOD).ranking()[0]
    assert worst.title == TO_MOTION
    assert worst.beside == {"bag_recorder": pytest.approx(0.5)}


def test_without_an_answer_it_waits_for_motor() -> None:
    system = usual()
    periods = Periods.of({"comms_manager": system.comms.lane()}, PERIOD)
    titles = {segment.title for segment in periods.segments}
    assert "comms_manager: waits for Motor" in titles
    assert not any("motion_manager" in title for title in titles)
    assert f"comms_manager: {SLEEP}" in titles


def test_a_service_that_says_nothing_is_named() -> None:
    with pytest.raises(SignalError, match="bag_recorder: said nothing"):
        Lane.of("bag_recorder", [])
    with pytest.raises(SignalError, match="comms_manager: said nothing"):
        Periods.of({}, PERIOD)
    with pytest.raises(SignalError, match="3 Proprioceptors; expected at least 4"):
        usual(2).periods()


def test_the_picture_is_drawn(tmp_path: Path) -> None:
    system = usual()
    system.period(control=0.005, idle=0.004, collects=0.001)
    system.period(late=0.003)
    periods = system.periods()
    file = period_plot.draw(periods, periods.ranking(), tmp_path / "trace.png")
    with Image.open(file) as picture:
        assert len(picture.convert("RGB").getcolors(1 << 24) or ()) > 100
