"""The HDT arms end to end: device thread ↔ Bifrost ↔ bridge ↔ ROS ↔ vendor's driver ↔ CAN FD ↔ emulated modules."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import bifrost
from harness.instance import RunningInstance, fresh_instance
from harness.places import ROBOTS
from harness.system import RosClient
from harness.waiting import wait_until
from valor.common.arrays import FloatArray
from valor.common.messages import FaultRequest, HdtCommand, HdtState, JointMode
from valor.common.topics import FAULT, HDT_COMMANDS, HDT_STATES
from valor.comms_manager.hardware.device import Device, DeviceContext, Fault, JointCommands, JointMeasurement
from valor.comms_manager.hardware.hdt import Hdt
from valor.comms_manager.hardware.rejoin import SPEED
from valor.comms_manager.hardware.series_elastic import SeriesElastic
from valor.robot.description import RobotDescription

PATIENCE = 60.0  # [s]
JUMP = 0.08  # more between two states than the joint's speed explains [rad]; noise and play are less
ROBOT = RobotDescription.load(ROBOTS / "escher")
STIFFNESS, DAMPING = ROBOT.servo_stiffness, ROBOT.servo_damping
LIMBS = ("left_arm", "right_arm", "left_hand", "right_hand")


@dataclass
class Bench:
    """The test bench, driver and bridge as processes; legs and arms led from here, as the Comms Manager leads them."""

    running: RunningInstance
    hdt: Hdt
    node: bifrost.Node
    wanted: FloatArray

    def __post_init__(self) -> None:
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._lead)
        self._thread.start()

    def _lead(self) -> None:
        """A Motor at 100 Hz: impedance, towards ``wanted`` at the joints' own gains."""
        zero, mode = np.zeros(len(self.wanted)), np.full(len(self.wanted), JointMode.IMPEDANCE, dtype=np.uint8)
        places = self.hdt.joints
        while not self._stopping.wait(0.01):
            self.hdt.send(JointCommands(1, mode, self.wanted, zero, zero, STIFFNESS[places], DAMPING[places]))

    def close(self) -> None:
        self._stopping.set()
        self._thread.join()

    @property
    def position(self) -> FloatArray:
        assert isinstance(self.hdt.joint_state, JointMeasurement)
        return self.hdt.joint_state.position

    def place(self, joint: str) -> int:
        return int(np.flatnonzero(self.hdt.joints == ROBOT.index[joint])[0])

    def said(self) -> dict[str, str]:
        """Unit → what is wrong with it."""
        return {ailment.unit: f"{ailment.fault}: {ailment.detail}" for ailment in self.hdt.ailments}

    def move(self, joint: str, by: float) -> None:
        wanted = self.wanted.copy()
        wanted[self.place(joint)] += by
        self.wanted = wanted

    def arrived(self, tolerance: float = 0.1) -> bool:
        return bool(np.abs(self.position - self.wanted).max() < tolerance)

    def fail(self, unit: str, fault: str, duration: float = 0.0) -> None:
        client = FAULT.client(self.node)
        reply = client.call(FaultRequest(device="hdt", unit=unit, fault=fault, duration=duration), 10.0)
        client.close()
        assert reply.accepted, reply.reason

    def well(self) -> None:
        """No faults, and everything where it is wanted."""
        self.fail("", "")
        wait_until(lambda: not self.hdt.ailments and self.arrived(), PATIENCE, f"all well again: {self.said()}")


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    home = Path(tempfile.mkdtemp(prefix="valor-"))
    try:
        with (
            fresh_instance(home, "hdt", variant="hardware", actuators="hardware", epoch=time.monotonic_ns()) as running,
            led(running) as bench,
        ):
            yield bench
    finally:
        shutil.rmtree(home, ignore_errors=True)


@contextmanager
def led(running: RunningInstance) -> Iterator[Bench]:
    """Its legs and arms found, and led from here."""
    stopping, devices, threads, bench = threading.Event(), list[Device](), list[threading.Thread](), None
    try:
        for process in ("device_emulators", "hdt_driver", "hdt_bridge"):
            running.start(process)
        running.wait_ready("hdt_driver", PATIENCE)
        context = DeviceContext(running.instance, running.settings, ROBOT)
        hdt = Hdt("hdt", context)
        devices += [SeriesElastic("legs", context), hdt]
        node = running.node("hdt_test")
        first = {name: HDT_COMMANDS[name].subscriber(node, queue=1000) for name in LIMBS}
        for device in devices:
            device.find()
        for device in devices:
            device.enable()

        def heard() -> bool:
            """Who is connected after the limbs have answered hears nothing; so they are told once more."""
            for limb in hdt._limbs:
                limb.answered = False
            hdt.enable()
            return all(each.ready() for each in first.values())

        wait_until(heard, PATIENCE, "the first commands are heard")
        begun = {name: _first_position(first[name], name) for name in LIMBS}
        assert isinstance(hdt.joint_state, JointMeasurement)
        there = hdt.joint_state.position
        for limb, part in zip(
            LIMBS, np.split(there, np.cumsum([len(begun[name]) for name in LIMBS])[:-1]), strict=True
        ):
            assert np.abs(begun[limb] - part).max() < 0.02, f"{limb}: the first command is not where the limb is"
        threads = [threading.Thread(target=device.run, args=(stopping,)) for device in devices]
        for thread in threads:
            thread.start()
        bench = Bench(running, hdt, node, there.copy())
        yield bench
    finally:
        if bench is not None:
            bench.close()
        stopping.set()
        for thread in threads:
            thread.join()
        for device in devices:
            device.close()


def _first_position(commands: bifrost.Subscriber[HdtCommand], limb: str) -> FloatArray:
    received = commands.receive(timeout=10.0)
    assert received is not None, f"no command to {limb}"
    commands.close()
    return received.message.position


class Way:
    """How joints of a limb move from now on, as its driver says."""

    def __init__(self, bench: Bench, limb: str) -> None:
        self._states: list[HdtState] = []
        self._subscriber = HDT_STATES[limb].subscriber(bench.node, queue=5000)

    def close(self) -> None:
        self._subscriber.close()

    @property
    def states(self) -> list[HdtState]:
        """Sound ones so far."""
        news = [received.message for received in self._subscriber.drain()]
        self._states += [state for state in news if not state.fault.any()]
        return self._states

    @property
    def largest_step(self) -> float:
        """How far any joint moved from one state to the next [rad], beyond what it may in that time."""
        states = self.states
        steps = np.abs(np.diff([state.position for state in states], axis=0))
        times = np.maximum(0.01, np.diff([1e-9 * state.time for state in states]))[:, None]
        return float((steps - times * ROBOT.velocity_limit[ROBOT.group_indices("left_arm")]).max(initial=-1.0))


def test_both_nodes_say_where_they_are_in_their_lives_and_log_to_ros(bench: Bench) -> None:
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState, GetState
    from rcl_interfaces.msg import Log

    from tests.integration.vrc.vrc_system import Topic, ask

    ros = RosClient(bench.running.environment, joint_states=False)
    try:
        rosout = Topic(ros, Log, "/rosout", latched=True)
        for name in ("hdt_driver", "hdt_bridge"):
            state = wait_until(lambda n=name: ask(ros, GetState, f"/{n}/get_state"), PATIENCE, name)  # type: ignore[misc]
            assert state is not None and state.current_state.label == "active"
            pause = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
            assert not ask(ros, ChangeState, f"/{name}/change_state", transition=pause.transition).success
            wait_until(
                lambda n=name: [line for line in rosout.messages if line.name == n and "deactivate" in line.msg],  # type: ignore[misc]
                PATIENCE,
                f"{name} to say why not",
            )
    finally:
        ros.close()


def test_arms_and_hands_follow_at_the_drivers_rate(bench: Bench) -> None:
    before = {record.unit: record.states for record in bench.hdt.records}
    bench.move("l_elbow_pitch", 0.4)
    bench.move("r_index_yaw", 0.4)
    wait_until(bench.arrived, PATIENCE, "the goal")

    def states() -> dict[str, int]:
        return {record.unit: record.states - before[record.unit] for record in bench.hdt.records}

    wait_until(lambda: min(states()[arm] for arm in ("left_arm", "right_arm")) >= 200, PATIENCE, "states of the arms")
    # A busy computer takes it from the arms first.
    wait_until(lambda: states()["left_hand"] < 0.9 * states()["left_arm"], PATIENCE, "hands are spoken to less often")
    for record in bench.hdt.records:
        assert record.latency_count and record.latency_sum > 0.0
        assert record.temperature > 20.0 and record.voltage == pytest.approx(48.0, abs=0.1)
    bench.move("l_elbow_pitch", -0.4)
    bench.move("r_index_yaw", -0.4)
    bench.well()


@pytest.mark.parametrize(
    ("process", "told"), [("hdt_bridge", "hdt_bridge is not there"), ("hdt_driver", "says nothing")]
)
def test_driver_and_bridge_may_die_and_come_back_without_a_jump(bench: Bench, process: str, told: str) -> None:
    elbow = bench.place("l_elbow_pitch")
    bench.running.kill(process)
    wait_until(lambda: set(bench.said()) == set(LIMBS), PATIENCE, "all limbs told silent")
    before = bench.position[elbow]
    bench.move("l_elbow_pitch", 0.5)  # whom nobody hears now
    wait_until(lambda: all(told in text for text in bench.said().values()), PATIENCE, f"{told}: {bench.said()}")
    path = Way(bench, "left_arm")
    bench.running.start(process)
    wait_until(lambda: path.states is not None and not bench.hdt.ailments, PATIENCE, f"{process} back")
    assert abs(bench.position[elbow] - before) < 0.1, "the arm held"
    wait_until(lambda: path.states and bench.arrived(), PATIENCE, "the goal, once somebody hears")
    took = 1e-9 * (path.states[-1].time - path.states[0].time)
    assert len(path.states) > 20 and path.largest_step < JUMP
    assert took > 0.8 * 0.4 / SPEED, f"0.5 rad in {took:.2f} s"
    path.close()
    bench.move("l_elbow_pitch", -0.5)
    bench.well()


def test_a_module_that_is_silent_is_named_and_the_others_go_on(bench: Bench) -> None:
    wrist, elbow = bench.place("r_wrist_yaw"), bench.place("r_elbow_pitch")
    bench.fail("r_wrist_yaw", "silent")
    wait_until(lambda: "r_wrist_yaw: no answer" in bench.said().get("right_arm", ""), PATIENCE, "the module named")
    assert set(bench.said()) == {"right_arm"}
    before = bench.position[wrist]
    bench.move("r_elbow_pitch", 0.3)
    bench.move("r_wrist_yaw", 0.3)
    wait_until(lambda: abs(bench.position[elbow] - bench.wanted[elbow]) < 0.1, PATIENCE, "the elbow goes on")
    assert bench.position[wrist] == before
    path = Way(bench, "right_arm")
    bench.fail("", "")
    wait_until(bench.arrived, PATIENCE, "the wrist, too")
    assert path.largest_step < JUMP, "without a jump"
    path.close()
    bench.move("r_elbow_pitch", -0.3)
    bench.move("r_wrist_yaw", -0.3)
    bench.well()


def test_a_limb_that_is_unplugged_is_found_where_it_hangs(bench: Bench) -> None:
    shoulder = bench.place("l_shoulder_roll")
    bench.move("l_shoulder_roll", 0.5)  # so that it falls when it is limp
    wait_until(bench.arrived, PATIENCE, "the arm out")
    bench.fail("left_arm", "unplugged", duration=1.5)
    wait_until(lambda: bench.said().get("left_arm", "").startswith(Fault.UNPLUGGED), PATIENCE, "told unplugged")
    assert "right_arm" not in bench.said()
    path = Way(bench, "left_arm")
    wait_until(lambda: not bench.hdt.ailments, PATIENCE, "plugged in again")
    fallen = bench.position[shoulder]
    wait_until(bench.arrived, PATIENCE, "back where it was wanted")
    assert bench.wanted[shoulder] - fallen > 0.05, "it was limp meanwhile"
    assert path.largest_step < JUMP, "not torn back"
    path.close()
    bench.move("l_shoulder_roll", -0.5)
    bench.well()


@pytest.mark.parametrize(
    ("fault", "expected"),
    [("over_temperature", "r_elbow_pitch: says that it is too hot"), ("encoder_jump", "r_elbow_pitch: its encoder")],
)
def test_what_a_module_says_of_itself_is_told_by_name(bench: Bench, fault: str, expected: str) -> None:
    place = bench.place("r_elbow_pitch")
    before = bench.position[place]
    bench.fail("r_elbow_pitch", fault)
    wait_until(lambda: expected in bench.said().get("right_arm", ""), PATIENCE, f"{fault} told: {bench.said()}")
    assert abs(bench.position[place] - before) < 0.1
    bench.well()


@pytest.mark.parametrize("fault", ["garbage", "duplicate", "late", "slow", "under_voltage"])
def test_what_goes_wrong_on_the_bus_moves_nothing(bench: Bench, fault: str) -> None:
    path = Way(bench, "left_arm")
    bench.fail("left_arm", fault, duration=5.0)
    if fault in ("garbage", "under_voltage"):
        wait_until(lambda: "left_arm" in bench.said(), PATIENCE, f"{fault} told")
    else:
        wait_until(lambda: len(path.states) > 5, PATIENCE, "states nevertheless")
    bench.well()
    assert path.largest_step < JUMP
    path.close()


def test_another_limb_than_robot_yaml_says_is_refused_by_name(bench: Bench, tmp_path: Path) -> None:
    folder = tmp_path / "escher"
    shutil.copytree(ROBOTS / "escher", folder)
    text = (folder / "robot.yaml").read_text()
    assert "HDT-A-0032" in text
    (folder / "robot.yaml").write_text(text.replace("HDT-A-0032", "HDT-A-0099"))
    bench.running.stop("hdt_driver")
    bench.running.configure(robot=folder)
    try:
        process = bench.running.start("hdt_driver")
        status, log = process.wait(PATIENCE), bench.running.log("hdt_driver")
        assert status == os.EX_CONFIG, log
        said = log.splitlines()[-1]
        assert "hdt/right_arm: segment 2 has serial number 'HDT-A-0032', robot.yaml expects 'HDT-A-0099'" in said
    finally:
        bench.running.configure(robot=ROBOTS / "escher")
        bench.running.kill("hdt_driver")
        bench.running.start("hdt_driver")
    bench.well()
