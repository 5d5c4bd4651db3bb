"""The simulated lidar for a ROS 2 program: scans by the clock, and a cloud of the ground."""

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import LaserScan, PointCloud2
from tf2_msgs.msg import TFMessage

from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.up.test_head_camera import LATCHED
from valor.lidar.service import POINT


def test_scans_come_at_their_rate_and_make_a_cloud_of_the_ground(ros: RosClient) -> None:
    scans: list[LaserScan] = []
    clouds: list[PointCloud2] = []
    frames: list[TFMessage] = []
    poses: list[Odometry] = []
    ros.node.create_subscription(Odometry, "/odom", poses.append, 1)
    ros.node.create_subscription(
        LaserScan, "/lidar/scan", scans.append, QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    ros.node.create_subscription(PointCloud2, "/lidar/points", clouds.append, 1)
    ros.node.create_subscription(TFMessage, "/tf_static", frames.append, LATCHED)
    wait_until(lambda: len(clouds) >= 2 and len(scans) >= 80, 60.0, "two clouds")
    stamps = [1_000_000_000 * each.header.stamp.sec + each.header.stamp.nanosec for each in scans]
    steps = np.diff(stamps)
    assert (steps % 25_000_000 == 0).all() and steps.min() == 25_000_000  # A busy machine drops scans, and shifts none.
    assert len(steps) / (1e-9 * (stamps[-1] - stamps[0])) > 20.0
    assert {("lidar", "laser")} <= {(t.header.frame_id, t.child_frame_id) for each in frames for t in each.transforms}
    scan, cloud = scans[-1], clouds[-1]
    assert len(scan.ranges) == 1081 and (scan.header.frame_id, scan.range_max) == ("laser", 30.0)
    assert np.degrees([scan.angle_min, scan.angle_max, scan.angle_increment]) == pytest.approx([-135, 135, 0.25])
    assert (scan.scan_time, 1440 * scan.time_increment) == pytest.approx((0.025, 0.025))
    assert (cloud.header.frame_id, cloud.point_step) == ("odom", POINT.itemsize)
    found = np.frombuffer(bytes(cloud.data), POINT)
    points = np.column_stack([found["x"], found["y"], found["z"]])
    assert len(points) == cloud.width > 10_000
    pelvis = poses[-1].pose.pose.position
    away = np.hypot(points[:, 0] - pelvis.x, points[:, 1] - pelvis.y)
    for height in (0.0, 0.1, 0.2, 0.3):  # floor and stairs
        level = points[np.abs(points[:, 2] - height) < 0.04, 2]
        assert len(level) > 1000 and np.median(level) == pytest.approx(height, abs=0.015)
    assert points[away < 0.35, 2].max(initial=0.0) < 0.05  # none of the robot
