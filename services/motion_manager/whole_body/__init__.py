"""The Whole-Body Controller: estimate, balance, fall detection (thesis 3.4.2; docs/whole_body_controller.md)."""

from motion_manager.whole_body.state import QpStatus, RobotState, UpperBodyReference, WholeBodyCommand

__all__ = ["QpStatus", "RobotState", "UpperBodyReference", "WholeBodyCommand"]
