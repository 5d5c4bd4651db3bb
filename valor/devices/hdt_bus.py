"""Datagrams between the HDT driver and emulated modules. HDT's own protocol is not public: this one is assumed.

On the Unix socket ``ports/<device>`` each limb answers every command with a state. Sequence 0 only requests a state.
After ``WATCHDOG`` without set-points, modules hold the last ones at rest, or, if there are none, their position.
"""

from enum import IntFlag

import numpy as np

WATCHDOG = 0.25  # [s]
SETPOINTS = ("position", "velocity", "effort", "stiffness", "damping")
MEASURED = ("position", "velocity", "effort", "temperature")

_START = [("limb", "u1"), ("frame", "<u8"), ("sequence", "<u8")]


class Fault(IntFlag):
    """Faults that a module reports (``HdtState.fault``); its driver or gateway sets NO_ANSWER."""

    OVER_TEMPERATURE = 1
    UNDER_VOLTAGE = 2
    ENCODER = 4
    NO_ANSWER = 8


def command_layout(joints: int) -> np.dtype[np.void]:
    """Command: limb, frame, sequence of the ``HdtCommand``, and its fields in SI units, (joints,) each."""
    return np.dtype([*_START, ("mode", "u1", joints), *((name, "<f8", joints) for name in SETPOINTS)])


def state_layout(joints: int) -> np.dtype[np.void]:
    """State: limb, answered frame, latest sequence, identity, (joints,) each [rad, rad/s, N·m, °C], [V], ``Fault``."""
    identity = [("serial", "S32"), ("firmware", "S16"), ("voltage", "<f8")]
    return np.dtype([*_START, *identity, ("fault", "u1", joints), *((name, "<f8", joints) for name in MEASURED)])
