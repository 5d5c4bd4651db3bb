"""The loop: ground truth in; scans, and clouds of half a turn of the spindle, out."""

import array
import math
import time
from collections import deque

import numpy as np
import numpy.typing as npt
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import Header

from valor.common.arrays import FloatArray
from valor.common.messages import GroundTruth
from valor.common.poses import Pose
from valor.common.topics import GROUND_TRUTH, MOTION_STATE
from valor.lidar.history import GAP, History
from valor.lidar.scanner import BEAMS, FARTHEST, FIRST, INCREMENT, KNOTS, NEAREST, PERIOD, STEP, Scan, Scanner
from valor.ros.clouds import cloud, header
from valor.ros.node import RosSide
from valor.ros.transforms import ODOM, publish_mount
from valor.service import Context, quiet_collector

FRAME = "laser"
SERVED = 10  # number of ground truths, 100 a second, from one check of ROS callbacks to the next
MOST = 400  # scans of a cloud, if the spindle turns slowly
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("index", "<i4")])  # as laser_geometry's


class LidarService:
    """``lidar/scan``, ``lidar/points`` and ``/tf_static``. Raises ConfigurationError: the robot has no lidar."""

    def __init__(self, context: Context) -> None:
        self._context, settings, robot = context, context.settings, context.robot
        self._truth = GROUND_TRUTH.subscriber(context.node, queue=64)
        self._motion = MOTION_STATE.subscriber(context.node)
        self._scanner = Scanner(robot, settings.world, settings.seed)
        self._side = RosSide(context.name, settings, context.instance.environment(), context.arguments)
        node, prefix = self._side.node, settings.frame_prefix
        self._frame, self._odom = prefix + FRAME, prefix + ODOM
        self._scans = node.create_publisher(LaserScan, "lidar/scan", qos_profile_sensor_data)
        self._clouds = node.create_publisher(PointCloud2, "lidar/points", 1)
        lidar = self._scanner.lidar
        publish_mount(node, prefix + lidar.body, self._frame, Pose(lidar.position))
        self._true, self._estimated = History(), History()
        self._sweep = Sweep()
        self._due = 0  # begin of the next scan [ns]
        self._side.life.configure()

    def run(self) -> None:
        """Scan until stopped."""
        quiet_collector()
        statistics, stopping, count = self._context.statistics, self._context.stopping, 0
        self._side.life.set_ready(True)
        while not stopping.is_set():
            received = self._truth.receive(0.25)
            if received is None or count % SERVED == 0:
                self._side.serve_pending()
                listeners = self._scans.get_subscription_count() + self._clouds.get_subscription_count()
                statistics.state("ready", f"{listeners} listening")
                statistics.idle()
            count += 1
            if received is not None:
                self._follow(received.message, listeners > 0)

    def close(self) -> None:
        """Close the ROS node."""
        self._side.close()

    def _follow(self, truth: GroundTruth, listened: bool) -> None:
        """Scan what is over now, with a period's delay, for which estimates have arrived."""
        self._true.add(truth.time, self._scanner.configuration(truth))
        if estimate := self._motion.latest():
            state = estimate.message
            pose = np.concatenate([state.pelvis_position_in_odom, state.pelvis_orientation_in_odom])
            self._estimated.add(state.time, pose)
        if not 0 <= truth.time - self._due < GAP:
            self._due, self._sweep = (truth.time // PERIOD + 1) * PERIOD, Sweep()
        while self._due + PERIOD <= truth.time:
            began = time.perf_counter()
            if listened and self._true.covers(self._due, truth.time):
                self._scan(self._due)
                self._context.statistics.cycle(began)
            else:
                self._sweep = Sweep()
            self._due += PERIOD

    def _scan(self, start: int) -> None:
        times = start + KNOTS
        configurations = self._true.at(times)
        scan = self._scanner.scan(configurations)
        self._scans.publish(_message(scan, header(start, self._frame)))
        if self._sweep.turned(float(configurations[0, self._scanner.spindle])):
            self._clouds.publish(self._sweep.cloud(self._odom))
        if self._estimated.covers(times[0], times[-1]):
            self._sweep.add(start, *scan.points(self._estimated.at(times)))


class Sweep:
    """Scans of half a turn of the spindle, as laser_assembler assembles them."""

    def __init__(self) -> None:
        self._half: int | None = None
        self._complete = False  # the first half was met in its middle
        self._parts = deque[npt.NDArray[np.void]](maxlen=MOST)
        self._last = 0  # begin of the last scan [ns]

    def turned(self, roll: float) -> bool:
        """Return whether half a turn is complete at the spindle's angle [rad]."""
        half = math.floor(roll / math.pi) % 2
        over = self._half not in (None, half)
        self._half = half
        if over and not self._complete:
            self._complete = True
            self._parts.clear()
        return over and bool(self._parts)

    def add(self, start: int, points: FloatArray, beams: npt.NDArray[np.intp]) -> None:
        """Append (k, 3) points of a scan [m] and their (k,) beams; ``start``: of the scan [ns]."""
        made = np.empty(len(points), POINT)
        made["x"], made["y"], made["z"] = points.T
        made["index"] = beams
        self._parts.append(made)
        self._last = start

    def cloud(self, frame: str) -> PointCloud2:
        """Return all points, and start anew. The stamp is that of the last scan."""
        points = np.concatenate(self._parts)
        self._parts.clear()
        return cloud(header(self._last, frame), points)


def _message(scan: Scan, header: Header) -> LaserScan:
    """Return the scan; its stamp is the time of the first beam."""
    return LaserScan(
        header=header, angle_min=FIRST, angle_max=FIRST + (BEAMS - 1) * STEP, angle_increment=STEP,
        time_increment=1e-9 * INCREMENT, scan_time=1e-9 * PERIOD, range_min=NEAREST, range_max=FARTHEST,
        ranges=array.array("f", scan.ranges.astype(np.float32).tobytes()),
    )  # fmt: skip
