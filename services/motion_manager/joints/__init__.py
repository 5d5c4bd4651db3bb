"""Joints: where each shall be, how it is driven, and the command for all motors."""
