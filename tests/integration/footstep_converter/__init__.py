"""The converter's process between an rclpy client and a scripted Motion Manager, over real DDS and real Bifrost."""
