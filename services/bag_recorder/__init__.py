"""The Bag Recorder: every Bifrost topic, converted, and every ROS topic, in one MCAP bag (thesis, 4.3.1)."""
