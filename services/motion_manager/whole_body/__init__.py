"""The Whole-Body Controller: estimate, balance, fall detection (thesis 3.4.2; docs/whole_body_controller.md)."""

from valor.motion_manager.whole_body.balance.fall import FallDetector
from valor.motion_manager.whole_body.controller import WholeBodyController
from valor.motion_manager.whole_body.estimation.estimator import FloatingBaseEstimator
from valor.motion_manager.whole_body.state import QpStatus, RobotState, UpperBodyReference, WholeBodyCommand

__all__ = [
    "FallDetector",
    "FloatingBaseEstimator",
    "QpStatus",
    "RobotState",
    "UpperBodyReference",
    "WholeBodyCommand",
    "WholeBodyController",
]
