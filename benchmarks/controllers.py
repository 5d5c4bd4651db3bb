"""Controllers beside each other on robots: the speeds that they follow, pushes that they survive, their exchange.

    python -m benchmarks.controllers [CASE …] [--profile hardware]

A case is a robot with its policies; a row of the table is one of its controllers. Results of cases are kept in
``build/controllers.json``, and the table is that of all of them. Some five minutes a row on an idle core.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from benchmarks.exchanges import Exchanges
from benchmarks.pushes import forked
from benchmarks.robots import MODELS
from harness.places import REPOSITORY, ROBOTS
from harness.strangers import PLAYGROUND, folder_of
from valor.common.behaviors import Behavior
from valor.motion_manager.controllers import controller_factories
from valor.robot.description import RobotDescription
from valor.robot.motion_tables import WHOLE_BODY
from valor.self_test.acceptance import DIRECTIONS, PUSH, RECOVERY
from valor.self_test.robot_in_process import RobotInProcess

CASES: Mapping[str, tuple[str, str, Iterable[str]]] = {  # robot's name, its model, policies
    "escher": ("escher", "", ()),
    "thor": ("thor", "", ()),
    "g1": ("g1", "g1_holosoma", ("ppo", "fastsac")),
    "t1_29": ("t1", "t1_29", ("ppo", "fastsac")),
    "t1": ("t1", "t1", (PLAYGROUND,)),
    "apollo": ("apollo", "apollo", (PLAYGROUND,)),
    "berkeley_humanoid": ("berkeley_humanoid", "berkeley_humanoid", (PLAYGROUND,)),
}
SPEED = 0.3  # [m/s]
STARTING, WALKING = 4.0, 6.0  # before the speed is measured, and while it is [s]
LADDER = np.arange(0.2, 1.5, 0.2)  # impulses by mass, until the robot falls or the controller is replaced [N·s/kg]
EXCHANGES = 3  # each way
FOLDERS, RESULTS = REPOSITORY / "build" / "controllers", REPOSITORY / "build" / "controllers.json"


def described(case: str) -> tuple[str, RobotDescription]:
    """Title and description of a case's robot, whose folder is made unless it is one of ours."""
    name, model, kinds = CASES[case]
    if not model:
        robot = RobotDescription.load(ROBOTS / name)
        return name.upper(), robot
    folder = FOLDERS / case
    shutil.rmtree(folder, ignore_errors=True)
    robot = RobotDescription.load(folder_of(name, MODELS[model].file(model), folder, tuple(kinds)))
    return MODELS[model].title, robot


def ready(robot: RobotDescription, profile: str, controller: str) -> RobotInProcess:
    """A standing robot under a controller. Raises RuntimeError, with the reason why it is not."""
    loop = RobotInProcess(robot, profile, 0, others=controller_factories(robot))
    reason = loop.stand_up()
    loop.run(1.0)
    exchange = loop.manager.components.exchange
    reason = reason or (controller != WHOLE_BODY and exchange.choose(controller, loop.manager.components.state)) or ""
    loop.run_until(lambda: exchange.active.name == controller, 5.0)
    loop.run(2.0)
    if reason or (reason := lost(loop, controller)):
        raise RuntimeError(reason)
    return loop


def lost(loop: RobotInProcess, controller: str) -> str:
    """Reason why a controller is not in control; empty if it is."""
    if loop.behavior is Behavior.FALL:
        return f"fell: {loop.manager.fsm.reason}"
    exchange = loop.manager.components.exchange
    return "" if exchange.active.name == controller else exchange.reason or "not in control"


def pushed(loop: RobotInProcess, controller: str, impulse: float, direction: tuple[float, float, float]) -> bool:
    """Push the standing robot [N·s]; whether the controller stays in control."""
    loop.plant.push(impulse * np.array(direction), PUSH)
    loop.run(RECOVERY)
    return not lost(loop, controller)


def walked(loop: RobotInProcess, controller: str, speed: float) -> float:
    """Walk; returns the mean speed along the way, nan if the controller was replaced or the robot fell [m/s]."""
    if loop.ask(Behavior.WALK):
        return float("nan")
    loop.walk((speed, 0.0, 0.0), STARTING)
    start = loop.plant.data.qpos[:2].copy()
    loop.walk((speed, 0.0, 0.0), WALKING)
    return float("nan") if lost(loop, controller) else float(np.hypot(*(loop.plant.data.qpos[:2] - start)) / WALKING)


def measured(robot: RobotDescription, profile: str, controller: str) -> dict[str, Any]:
    """A row: speed [m/s], impulses by direction [N·s/kg], exchanges walking."""
    try:
        loop = ready(robot, profile, controller)
    except RuntimeError as error:
        return {"reason": str(error)}
    found: dict[str, Any] = {"speed": forked(walked, loop, controller, SPEED), "pushes": []}
    for direction in DIRECTIONS.values():
        survived = 0.0
        for impulse in LADDER:
            if not forked(pushed, loop, controller, impulse * robot.tables.size.mass, direction):
                break
            survived = float(impulse)
        found["pushes"].append(survived)
    if controller != WHOLE_BODY:
        exchanges = Exchanges(robot, profile, controller, SPEED)
        rows = exchanges.run(EXCHANGES).values()
        found["exchanges"] = [sum(row.done for row in rows), 2 * EXCHANGES, max(row.step for row in rows)]
    return found


def table(results: Mapping[str, Any]) -> Iterable[str]:
    """Lines of the table of all results."""
    heads = ["robot", "controller", f"walks [m/s], asked for {SPEED:g}"]
    heads += ["pushed forward, backward, left, right [N·s/kg]", "exchanged walking", "largest step of a torque"]
    yield f"| {' | '.join(heads)} |"
    yield "|---" * len(heads) + "|"
    for case in (case for case in CASES if case in results):
        for controller, row in results[case]["rows"].items():
            cells = [results[case]["title"], controller]
            if reason := row.get("reason"):
                cells += [reason, "–", "–", "–"]
            else:
                cells += [
                    f"{row['speed']:.2f}".replace("nan", "–"),
                    ", ".join(f"{each:.1f}" for each in row["pushes"]),
                ]
                done, asked_for, step = row.get("exchanges", (0, 0, 0.0))
                cells += [f"{done} of {asked_for}", f"{step:.0%}"] if asked_for else ["–", "–"]
            yield f"| {' | '.join(cells)} |"


def main() -> None:
    """Measure cases, and print the table of all that were measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--profile", default="hardware")
    options = parser.parse_args()
    for case in options.cases or CASES:
        title, robot = described(case)
        rows = {}
        for controller in dict.fromkeys((WHOLE_BODY, *CASES[case][2])):
            rows[controller] = measured(robot, options.profile, controller)
            print(case, controller, rows[controller], flush=True)
        results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
        RESULTS.write_text(json.dumps(results | {case: {"title": title, "rows": rows}}, indent=1))
    print(*table(json.loads(RESULTS.read_text())), sep="\n")


if __name__ == "__main__":
    main()
