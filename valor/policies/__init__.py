"""Trained policies: ONNX files with facts about them; free of ROS and of the simulator."""
