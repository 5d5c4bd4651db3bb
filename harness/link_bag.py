"""States of a recording as the link's robot end would have sent them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from valor.analysis.bag import Bag
from valor.common.arrays import FloatArray
from valor.link.state import RobotState
from valor.robot.description import RobotDescription
from valor.ros.limbs import FEET, WRENCH


def states(file: Path, robot: RobotDescription, rate: float) -> list[RobotState]:
    """Those of a bag, ``rate`` a second of robot time."""
    bag = Bag(file)
    joints, odometry, mode = bag["/joint_states"], bag["/odom"], bag["/flor/controller/mode"]
    motion = bag["/flor/controller/motion_state"]
    feet = [bag[f"/{WRENCH.format(foot)}"] for foot in FEET]
    order = [joints.messages[0].name.index(name) for name in robot.joints]
    start, end = joints.time[0], joints.time[-1]
    found = []
    for now in np.arange(start + 0.5, end, 1.0 / rate):
        at = {each.topic: int(np.searchsorted(each.time, now, side="right")) - 1 for each in
              (joints, odometry, mode, motion, *feet)}  # fmt: skip
        last = {each.topic: each.messages[max(at[each.topic], 0)] for each in (joints, odometry, mode, motion, *feet)}
        pose, twist = last["/odom"].pose.pose, last["/odom"].twist.twist
        wrenches = [last[each.topic].wrench for each in feet]
        told = last[mode.topic]
        found.append(RobotState(
            joints=np.asarray(last["/joint_states"].position)[order],
            clock=round(1e3 * now), stamp=round(1e3 * joints.time[at["/joint_states"]]),
            base_position=_vector(pose.position),
            base_orientation=np.array((pose.orientation.w, *_vector(pose.orientation))),
            base_velocity=_vector(twist.linear), base_turn=_vector(twist.angular),
            foot_forces=np.concatenate([_vector(each.force) for each in wrenches]),
            foot_torques=np.concatenate([_vector(each.torque) for each in wrenches]),
            mode=told.current_control_mode, requested_mode=told.requested_control_mode, mode_status=told.status,
            mode_age=min(1.0, now - mode.time[max(at[mode.topic], 0)]), behavior=last[motion.topic].behavior,
            behavior_age=0.05, contacts=int(last[motion.topic].contacts[0]) + 2 * int(last[motion.topic].contacts[1]),
            fault_level=0,
        ))  # fmt: skip
    return found


def _vector(each: object) -> FloatArray:
    return np.array([getattr(each, axis) for axis in "xyz"])
