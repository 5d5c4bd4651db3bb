"""``demo walk`` as a person runs it: a short way on the dirt course, and Ctrl-C on it."""

import json
import signal
from pathlib import Path

import matplotlib.image
import pytest

from harness.system import System, leftovers, shared_memory
from valor.analysis.reading.bag import Bag

ARGUMENTS = ("demo", "walk", "--speed", "0.3", "--seed", "1", "--rtf", "0")


@pytest.fixture
def system(home: Path) -> System:
    return System("demo-walk", home)


def test_walks_a_metre_of_dirt_and_leaves_figures_pictures_and_nothing_else(system: System, home: Path) -> None:
    before = shared_memory()
    out = home / "out"
    output = system.valorctl(*ARGUMENTS, "--distance", "1", "--out", str(out), timeout=170.0).stdout
    figures = json.loads((out / "walk.json").read_text())
    assert 0.8 < figures["distance_m"] < 2.5 and not figures["fell"] and figures["solver_failures"] == 0
    assert max(figures["dcm_error_rms_m"].values()) < 0.05 and figures["smallest_knee_angle_rad"] > 0.2
    assert 0.0 < figures["foot_force_error_median_n"] < 60.0 and figures["ticks"] > 1000
    for line in ("distance", "falls", "DCM error, rms", "deadlines missed", "everything is shut down"):
        assert line in output
    assert Bag(out / "walk.mcap").origin["world"] == "dirt"
    for name in ("path", "dynamics", "on_the_way"):
        assert matplotlib.image.imread(out / f"{name}.png")[:, :, :3].std() > 0.05
    assert leftovers(home, system.name, before) == []


def test_of_two_at_once_the_second_is_refused_and_the_files_of_the_first_stay(system: System, home: Path) -> None:
    file = home / "out" / "walk.mcap"
    file.parent.mkdir()
    file.write_bytes(b"of the first")
    system.valorctl("up", "--profile", "bifrost")
    try:
        output = system.valorctl(*ARGUMENTS, "--out", str(home / "out"), expect=1).stderr
    finally:
        system.valorctl("down")
    assert f"is up already; `valorctl down --instance {system.name}` first" in output
    assert file.read_bytes() == b"of the first"


def test_ctrl_c_on_the_way_leaves_nothing_running(system: System, home: Path) -> None:
    before = shared_memory()
    with system.start(*ARGUMENTS, "--distance", "20", "--out", str(home / "out")) as demo:
        assert demo.stdout is not None
        for line in demo.stdout:
            if line.startswith("control mode stand"):
                demo.send_signal(signal.SIGINT)
    assert demo.returncode == 128 + signal.SIGINT
    assert leftovers(home, system.name, before) == []
