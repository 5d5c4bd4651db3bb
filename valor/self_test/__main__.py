"""``python -m valor.self_test ROBOT PROFILE``: run the acceptance tests; prints JSON at start and end of each.

With ``--policy FILE`` those of a policy as the robot's controller.
"""

import argparse
import sys
from functools import partial
from pathlib import Path

import msgspec

from valor.common.errors import ValorError
from valor.policies.factories import policy_controller
from valor.robot.description import RobotDescription
from valor.self_test.acceptance import SelfTest
from valor.self_test.controller_test import ControllerTest
from valor.self_test.results import PROFILES, Started


def main() -> int:
    """Return 0 if all tests passed, 1 if one failed, 2 with a message if none could start."""
    parser = argparse.ArgumentParser(prog="python -m valor.self_test", description=__doc__)
    parser.add_argument("robot", type=Path, help="folder of the robot")
    parser.add_argument("profile", choices=PROFILES, help="actuator profile of robot.yaml")
    parser.add_argument("--policy", type=Path, help="ONNX file of a policy")
    arguments = parser.parse_args()
    failed = False
    try:
        robot = RobotDescription.load(arguments.robot)
        for name, run in _tests(robot, arguments.profile, arguments.policy).tests():
            _print(Started(arguments.profile, name))
            result = run()
            failed = failed or not result.passed
            _print(result)
    except ValorError as error:
        print(f"valor.self_test: {error}", file=sys.stderr)
        return 2
    return int(failed)


def _tests(robot: RobotDescription, profile: str, file: Path | None) -> SelfTest | ControllerTest:
    if file is None:
        return SelfTest(robot, profile)
    return ControllerTest(robot, profile, file.stem, partial(policy_controller, file))


def _print(line: msgspec.Struct) -> None:
    print(msgspec.json.encode(line).decode(), flush=True)


if __name__ == "__main__":
    sys.exit(main())
