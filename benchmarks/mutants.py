"""Mutations of a robot's folder: what `up` accepts must stand for 10 s under control; the rest names file and reason.

``python -m benchmarks.mutants [--count 100] [--seed 0] [--robot escher]``: each number becomes 0, -1, a million times
or a millionth of itself, and NaN; each name becomes the file's next one; each line is dropped. Prints one line for each
mutation that is accepted and does not stand, and for each one that ends in another error than a ConfigurationError.
"""

from __future__ import annotations

import argparse
import random
import re
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from harness.places import ROBOTS
from valor.common.errors import ConfigurationError, SeveralFaultsError
from valor.common.table import plain
from valor.robot.description import RobotDescription
from valor.robot.model import robot_spec
from valor.self_test.closed_loop import MeasuredLoop
from valor.simulation.plant import SimulationDivergedError
from valor.valorctl.instance import instance_setup
from valor.valorctl.instance.instance_setup import Request

MUTATED = ("robot.yaml", "model.xml", "get_up.yaml")
STANDING, TILT = 10.0, 0.3  # duration [s]; largest tilt of the base [rad]
_NUMBER = re.compile(r"(?<![\w.#-])-?\d+(?:\.\d+)?(?![\w.])")
_NAME = re.compile(r"(?<![\w.])[A-Za-z][A-Za-z]*(?:_[A-Za-z0-9]+)+")
_UNSEEN = ("devices", "calibration", "supply", "arm_presets", "hand_presets", "link_frames", "name")


class Mutation(NamedTuple):
    """A changed line of a file."""

    file: str
    line: int  # from 0
    text: str  # new line
    what: str


def mutants(file: Path) -> Iterator[Mutation]:
    """Yield all mutations of a file; comments stay."""
    lines = file.read_text().splitlines(keepends=True)
    names = sorted({name for line in lines for name in _NAME.findall(line)})
    other = dict(zip(names, names[1:] + names[:1], strict=True))
    for number, line in enumerate(lines):
        code = line.partition("#")[0] if file.suffix == ".yaml" else line
        if not code.strip() or code.lstrip().startswith("<!--"):
            continue
        yield Mutation(file.name, number, "", f"without {line.strip()[:80]}")
        changes = [
            (found, f"{float(found[0]) * factor:.9g}") for found in _NUMBER.finditer(code) for factor in (1e6, 1e-6)
        ]
        not_a_number = ".nan" if file.suffix == ".yaml" else "nan"
        changes += [(found, new) for found in _NUMBER.finditer(code) for new in ("0", "-1", not_a_number)]
        changes += [(found, other[found[0]]) for found in _NAME.finditer(code)]
        for found, new in changes:
            text = line[: found.start()] + new + line[found.end() :]
            yield Mutation(file.name, number, text, f"{found[0]} → {new} in {line.strip()[:80]}")


def written(source: Path, folder: Path, *chosen: Mutation) -> None:
    """Write a robot's folder with mutations; of several of one line the last counts."""
    for file in source.iterdir():
        lines = file.read_text().splitlines(keepends=True)
        for mutation in chosen:
            if mutation.file == file.name:
                lines[mutation.line] = mutation.text
        (folder / file.name).write_text("".join(lines))


def _simulated(robot: RobotDescription) -> tuple[object, str]:
    """Return what the closed loop depends on."""
    tables = {key: value for key, value in plain(robot.tables).items() if key not in _UNSEEN}
    return tables, robot_spec(robot, "collision", passive=True).to_xml()


def stands(robot: RobotDescription) -> str:
    """Return why a robot does not stand for 10 s; empty if it does."""
    try:
        loop = MeasuredLoop(robot, "hardware")
        while loop.time < STANDING and loop.fall is None and loop.tilt < TILT:
            loop.run(0.1)
    except SimulationDivergedError as error:
        return str(error)
    why = loop.fall or (f"tilt of {loop.tilt:.2f} rad" if loop.tilt >= TILT else "")
    return f"{why} at {loop.time:.1f} s" if why else ""


def result(source: Path, folder: Path, mutation: Mutation, usual: tuple[object, str]) -> str:
    """Return "rejected", "unseen" (nothing changes for the closed loop), "stands", or what is wrong."""
    written(source, folder, mutation)
    try:
        instance_setup.plan(Request(robot=str(folder), profile="hardware"))
        robot = RobotDescription.load(folder)
        if _simulated(robot) == usual:
            return "unseen"
        return stands(robot) or "stands"
    except ConfigurationError as error:
        unnamed = [str(fault) for fault in SeveralFaultsError.each(error) if not str(fault).startswith(str(folder))]
        return f"rejected without a file: {unnamed[0]}" if unnamed else "rejected"
    except Exception as error:  # what is looked for
        return f"{type(error).__name__}: {error}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="escher")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    source = ROBOTS / options.robot
    usual = _simulated(RobotDescription.load(source))
    every = [mutation for file in MUTATED if (source / file).exists() for mutation in mutants(source / file)]
    counts: dict[str, int] = {}
    began = time.monotonic()
    for mutation in random.Random(options.seed).sample(every, min(options.count, len(every))):
        with tempfile.TemporaryDirectory() as folder:
            found = result(source, Path(folder), mutation, usual)
        known = found if found in {"rejected", "unseen", "stands"} else "wrong"
        counts[known] = counts.get(known, 0) + 1
        if known == "wrong":
            print(f"{mutation.file}:{mutation.line + 1}: {mutation.what}: {found}", flush=True)
    print(f"{sum(counts.values())} of {len(every)} mutations in {time.monotonic() - began:.0f} s: {counts}")


if __name__ == "__main__":
    main()
