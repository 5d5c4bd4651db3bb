"""Names on ROS: feet and hands in topics, left before right, as Team ViGIR's; keys of diagnostics of the VRC."""

FEET = ("l_foot", "r_foot")
HANDS = ("l_hand", "r_hand")
WRENCH = "flor/{}/force_torque_sensor"
"""Topic of a limb's wrench."""

# Keys of the VRC's /diagnostics that valorctl reads.
LAST_MODE_REJECTED = "last control mode rejected"
LAST_TRAJECTORY_REJECTED = "last trajectory rejected"
