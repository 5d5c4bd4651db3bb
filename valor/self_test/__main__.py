"""``python -m valor.self_test ROBOT PROFILE``: run the acceptance tests; prints JSON at start and end of each."""

import argparse
import sys
from pathlib import Path

import msgspec

from valor.common.errors import ValorError
from valor.robot.description import RobotDescription
from valor.self_test.acceptance import SelfTest
from valor.self_test.results import PROFILES, Started


def main() -> int:
    """Return 0 if all tests passed, 1 if one failed, 2 with a message if none could start."""
    parser = argparse.ArgumentParser(prog="python -m valor.self_test", description=__doc__)
    parser.add_argument("robot", type=Path, help="folder of the robot")
    parser.add_argument("profile", choices=PROFILES, help="actuator profile of robot.yaml")
    arguments = parser.parse_args()
    failed = False
    try:
        for name, run in SelfTest(RobotDescription.load(arguments.robot), arguments.profile).tests():
            _print(Started(arguments.profile, name))
            result = run()
            failed = failed or not result.passed
            _print(result)
    except ValorError as error:
        print(f"valor.self_test: {error}", file=sys.stderr)
        return 2
    return int(failed)


def _print(line: msgspec.Struct) -> None:
    print(msgspec.json.encode(line).decode(), flush=True)


if __name__ == "__main__":
    sys.exit(main())
