"""What topics call feet and hands, left before right: Team ViGIR's ``flor/l_hand/goal_pose`` and the like."""

from __future__ import annotations

FEET = ("l_foot", "r_foot")
HANDS = ("l_hand", "r_hand")
WRENCH = "flor/{}/force_torque_sensor"
"""Topic of the wrench at one of them."""
