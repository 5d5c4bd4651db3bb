"""The HDT driver's exchange with its modules: which states it accepts, and when a limb has timed out."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.places import ROBOTS
from valor.devices.hdt_bus import Fault, command_layout, state_layout
from valor.devices.table import HdtBifrost
from valor.hdt_driver.limb import Limb, Setpoints
from valor.hdt_driver.service import MISSES, ModuleBus, Modules
from valor.robot.description import RobotDescription

ROBOT = RobotDescription.load(ROBOTS / "escher")
K = 7


class Bench:
    """One arm's driver, and its modules played by the test."""

    def __init__(self, path: Path) -> None:
        self.modules = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self.modules.bind(str(path))
        table = ROBOT.tables.devices["hdt"]
        assert isinstance(table, HdtBifrost)
        self.table = table.limbs[0]
        self.limb = Limb(ROBOT, self.table.group, 0.01)
        self.limb.accept(Setpoints(17, np.ones(K, np.uint8), *np.zeros((5, K))), 0.0)
        self.state = Modules(0, self.limb, self.table)
        self.bus = ModuleBus(path, [self.state])

    def cycle(self, *answers: dict[str, Any], raw: bytes | None = None) -> np.void:
        """One cycle: modules send answers with some changed fields. Returns the command."""
        self.bus.send(self.state, 0.0)
        data, driver = self.modules.recvfrom(4096)
        command: np.void = np.frombuffer(data, command_layout(K))[0]
        for changes in answers:
            state = np.zeros((), state_layout(K))
            fields = {"frame": command["frame"], "serial": self.table.serial, "firmware": self.table.firmware}
            for name, value in (fields | changes).items():
                state[name] = value
            self.modules.sendto(state.tobytes(), driver)
        if raw is not None:
            self.modules.sendto(raw, driver)
        self.bus.receive(time.monotonic())
        self.bus.finish(self.state)
        return command


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path / "hdt")
    yield bench
    bench.bus.close()
    bench.modules.close()


def test_set_points_are_sent_once_the_identity_is_known(bench: Bench) -> None:
    assert not bench.cycle({"position": 0.01})["sequence"], "only a request"
    assert not bench.state.wrong
    command = bench.cycle({})
    assert command["sequence"] == 17 and command["mode"].tolist() == [1] * K
    bench.cycle({"sequence": 17})
    assert bench.limb.applied == 17


@pytest.mark.parametrize("changes", [{"serial": "HDT-A-0099"}, {"firmware": "9.9"}])
def test_another_identity_is_reported_and_receives_no_set_points(bench: Bench, changes: dict[str, str]) -> None:
    bench.cycle(changes)
    (value,) = changes.values()
    assert value in bench.state.wrong and "robot.yaml" in bench.state.wrong and not bench.cycle()["sequence"]
    assert (bench.limb.fault & Fault.NO_ANSWER).all()


def test_invalid_repeated_and_old_states_are_errors(bench: Bench) -> None:
    bench.cycle({"position": 0.01}, {"position": 0.02})
    bench.bus.receive(time.monotonic())
    assert bench.bus.errors == 1 and bench.limb.position[0] == 0.01, "repeated"
    bench.cycle({"frame": 1, "position": 0.02})
    assert bench.bus.errors == 2 and bench.limb.position[0] == 0.01, "old"
    bench.cycle(raw=bytes(7))
    bench.cycle(raw=b"\xff" * 100)
    assert bench.bus.errors == 4


def test_a_limb_times_out_and_is_used_again(bench: Bench) -> None:
    bench.cycle({})
    for _ in range(MISSES):
        assert not bench.state.wrong and not bench.limb.fault.any()
        bench.cycle()
    assert bench.state.wrong and (bench.limb.fault & Fault.NO_ANSWER).all()
    bench.cycle({})
    assert not bench.state.wrong and not bench.limb.fault.any()


def test_missing_modules_are_no_exception(bench: Bench) -> None:
    bench.modules.close()
    bench.bus.send(bench.state, 0.0)
    assert bench.bus.errors == 1
