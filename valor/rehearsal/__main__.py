"""``python -m valor.rehearsal ROBOT PROFILE``: play a robot; a line of JSON as each rung begins, and as it ends."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from valor.common.errors import ValorError
from valor.rehearsal.rungs import PROFILES, Rehearsal
from valor.robot.description import RobotDescription


def main() -> int:
    """Play. 1: a rung failed; 2: nothing could be played, and why."""
    parser = argparse.ArgumentParser(prog="python -m valor.rehearsal", description=__doc__)
    parser.add_argument("robot", type=Path, help="a robot's folder")
    parser.add_argument("profile", choices=PROFILES, help="of robot.yaml's actuators")
    arguments = parser.parse_args()
    failed = False
    try:
        for name, play in Rehearsal(RobotDescription.load(arguments.robot), arguments.profile).rungs():
            print(json.dumps({"profile": arguments.profile, "begins": name}), flush=True)
            rung = play()
            failed = failed or not rung.passed
            print(json.dumps({"profile": arguments.profile, **rung.plain()}), flush=True)
    except ValorError as error:
        print(f"valor.rehearsal: {error}", file=sys.stderr)
        return 2
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
