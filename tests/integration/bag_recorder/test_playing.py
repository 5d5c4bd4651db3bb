"""A bag is played."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from vigir_humanoid_control_msgs.action import ChangeControlMode

from harness.instance import RunningInstance
from harness.waiting import wait_until
from tests.integration.bag_recorder.recorder import (
    SECOND,
)
from valor.bag_recorder.bag import Bag, RecordedTopic
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.ros.definitions import definition
from valor.valorctl import bag_player
from valor.valorctl.ros_domain import DOMAINS


def test_a_bag_is_played_in_order_and_at_its_pace_but_not_into_a_running_system(
    instance: RunningInstance, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in instance.instance.environment().items():
        monkeypatch.setenv(name, value)
    bag = Bag(tmp_path / "played.mcap")
    kept = RecordedTopic("/kept", "std_msgs/msg/String", definition("std_msgs/msg/String"))
    chatter = RecordedTopic("/chatter", "std_msgs/msg/String", definition("std_msgs/msg/String"), "durability: 1", True)
    unknown = RecordedTopic("/wand", "magic_msgs/msg/Wand", "bool on\n")
    feedback_type = "vigir_humanoid_control_msgs/action/ChangeControlMode_Feedback"
    feedback = RecordedTopic("/arm/state", feedback_type, definition(feedback_type))
    bag.write(feedback, 0, 0, 0, serialize_message(ChangeControlMode.Feedback()))
    for number in (1, 0, 3, 2, 4):  # a recorder writes one topic after the other
        bag.write(chatter, number * SECOND // 5, 0, number, serialize_message(String(data=str(number))))
    bag.write(kept, 0, 0, 0, serialize_message(String(data="first")))
    bag.write(unknown, 1, 0, 0, b"\0\1\0\0\1")
    bag.close()
    domain = instance.settings.ros_domain_id
    quiet: dict[str, Any] = {"rate": 1.0, "topics": (), "check": lambda: None, "tell": lambda passed, messages: None}
    with pytest.raises(ValorError, match=f"ROS domain {domain} is a running system's"):
        bag_player.play(bag.path, instance.instance, domain=domain, **quiet)

    heard: list[str] = []
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # found late, it still hears all
    nobodys = domain + len(DOMAINS)  # beyond those of instances, and of no other test
    context = Context()
    rclpy.init(context=context, domain_id=nobodys)
    listener = rclpy.create_node("listener", context=context)
    listener.create_subscription(String, "/chatter", lambda message: heard.append(message.data), latched)
    elsewhere = Instance("elsewhere", tmp_path)
    done = []
    player = threading.Thread(
        target=lambda: done.append(bag_player.play(bag.path, elsewhere, domain=nobodys, **quiet)), daemon=True
    )
    began = time.monotonic()
    player.start()
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(listener)

    def spun() -> bool:
        executor.spin_once(timeout_sec=0.05)
        return len(heard) == 5

    wait_until(spun, 30.0, "all five are heard", 0.0)
    player.join(20.0)
    assert done[0].messages == 7 and list(done[0].skipped) == ["/wand"]
    assert heard == ["0", "1", "2", "3", "4"]
    assert time.monotonic() - began > 0.8
    listener.destroy_node()
    context.shutdown()
