"""Results of the self-test as ``python -m valor.self_test`` prints them: one JSON object a line."""

import msgspec

PROFILES = ("ideal", "hardware")


class Measurements(msgspec.Struct, frozen=True):
    """Measurements during an acceptance test."""

    tilt: float  # largest angle of the base from upright [rad]
    dcm_error: float | None  # RMS of the worst axis [m]; None: not controlled
    distance: float  # of the base, horizontal [m]
    knee_margin: float | None  # smallest distance of a knee from its limits [rad]; None: no knee was moved
    at_limit: dict[str, float]  # share of the periods with the joint's torque at its limit, of joints that reached it
    unsolved: int  # periods whose QP had no solution


class AcceptanceResult(msgspec.Struct, frozen=True):
    """Result of one acceptance test under an actuator profile."""

    profile: str
    name: str
    passed: bool
    reason: str = ""  # why it failed; empty if it passed
    told: str = ""  # the measurement of the test itself, human-readable
    numbers: Measurements | None = None  # None if the test could not start


class Started(msgspec.Struct, frozen=True):
    """Start of one acceptance test."""

    profile: str
    begins: str
