"""What ``docs/interfaces.md`` promises is in the graph of a live system, and the other way round."""

from __future__ import annotations

import itertools
from typing import Any
from xml.etree import ElementTree

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import GetParameters
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from harness.system import RosClient
from harness.waiting import wait_until
from tests.integration.vrc.documented_interfaces import PLACEHOLDERS, Row, names, rows, tables
from tests.integration.vrc.vrc_system import PATIENCE, VRC, Topic, ask, go, stamp
from valor.ros.definitions import message_type
from valor.valor_ros_controller.control_modes import ControlModeTable

OF_ROS = ("/rosout", "/parameter_events")


def full(kind: str, group: str) -> str:
    """Of ``package/Type`` the name in the graph."""
    return kind if kind.count("/") > 1 else kind.replace("/", f"/{group}/")


def topics(ros: RosClient) -> dict[str, list[str]]:
    return dict(ros.node.get_topic_names_and_types())


def services(ros: RosClient) -> dict[str, list[str]]:
    return dict(ros.node.get_service_names_and_types())


def of_kind(title: str) -> list[Row]:
    return list(itertools.chain.from_iterable(rows(title)))


def topic_rows() -> tuple[list[Row], list[Row]]:
    """In, out."""
    bypass_in, bypass_out = rows("Controller Bypass")
    return of_kind("Topics in") + bypass_in, of_kind("Topics out") + bypass_out


def test_every_documented_action_and_service_is_served(ros: RosClient) -> None:
    actions = {row.name: row.type for row in of_kind("Actions (valor_ros_controller)")}
    assert len(actions) == 1 + 2 * len(PLACEHOLDERS["<controller>"])

    def missing() -> list[str]:
        found = services(ros)
        wanted = {f"{name}/_action/send_goal": f"{full(kind, 'action')}_SendGoal" for name, kind in actions.items()}
        for row in of_kind("Services (valor_ros_controller)"):
            wanted[row.name] = full(row.type, "srv") if row.type else ""
        return [name for name, kind in wanted.items() if name not in found or (kind and kind not in found[name])]

    wait_until(lambda: not missing(), PATIENCE, f"services and actions: {missing()}")


def test_every_documented_topic_is_in_the_graph_with_its_type_and_nothing_else_is(ros: RosClient) -> None:
    inward, outward = topic_rows()
    wanted = {row.name: full(row.type, "msg") for row in inward + outward}

    def missing() -> dict[str, str]:
        found = topics(ros)
        return {name: kind for name, kind in wanted.items() if kind not in found.get(name, [])}

    wait_until(lambda: not missing(), PATIENCE, f"topics: {missing()}")
    # Topics are discovered by themselves, and whose they are a moment later.
    wait_until(lambda: VRC in ros.node.get_node_names(), PATIENCE, "the VRC's node")
    for listed, documented in (
        (ros.node.get_publisher_names_and_types_by_node, outward),
        (ros.node.get_subscriber_names_and_types_by_node, inward),
    ):
        known = {row.name for row in documented}
        found = {
            name
            for name, _ in listed(VRC, "/")
            if "/_action/" not in name and name not in OF_ROS and not name.endswith("/transition_event")
        }
        assert found <= known, f"not documented: {sorted(found - known)}"


def test_publishers_have_the_documented_quality_of_service(ros: RosClient) -> None:
    _, outward = topic_rows()
    for row in outward:
        found = [info for info in ros.node.get_publishers_info_by_topic(row.name) if info.node_name == VRC]
        assert found, row.name
        words = row.cells["QoS"]
        for info in found:
            latched = info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
            assert latched == ("transient local" in words), row.name
            assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE, row.name


def test_who_joins_late_has_what_is_latched_and_hears_what_streams(ros: RosClient) -> None:
    """Every topic out gives a message to a subscriber that comes long after the start."""
    _, outward = topic_rows()
    rare = ("goal_status", "rejection")  # there only on an occasion
    heard = {
        row.name: Topic(
            ros, message_type(full(row.type, "msg")), row.name, latched="transient local" in row.cells["QoS"]
        )
        for row in outward
        if not row.name.endswith(rare)
    }

    go(ros, "manipulate")  # every trajectory controller is active
    wait_until(lambda: all(topic.messages for topic in heard.values()), PATIENCE, "a message on every topic")
    go(ros, "stand")
    description = heard["/robot_description"].messages[0].data
    assert ElementTree.fromstring(description).get("name") == "escher"
    for topic in heard.values():
        topic.close()


@pytest.mark.parametrize(
    ("name", "rate"),
    [
        ("/joint_states", 250.0),
        ("/imu/data", 250.0),
        ("/odom", 125.0),
        *((f"/flor/{limb}/force_torque_sensor", 125.0) for limb in ("l_foot", "r_foot", "l_hand", "r_hand")),
    ],
)
def test_the_state_comes_at_its_rate_in_robot_time_and_in_order(ros: RosClient, name: str, rate: float) -> None:
    topic = Topic(ros, message_type(topics(ros)[name][0]), name)
    wait_until(lambda: len(topic.messages) > rate, PATIENCE, f"a second of {name}")
    topic.close()
    stamps = [stamp(message) for message in topic.messages]
    steps = sorted(after - before for before, after in itertools.pairwise(stamps))
    assert steps[0] > 0, "stamps go back or stand still"
    assert steps[len(steps) // 4] * 1e-9 == pytest.approx(1.0 / rate, rel=0.01)


def test_diagnostics_tell_of_every_process(ros: RosClient) -> None:
    diagnostics = Topic(ros, DiagnosticArray, "/diagnostics")

    def told() -> dict[str, Any]:
        return {status.name: status for message in diagnostics.messages[-1:] for status in message.status}

    def ready() -> bool:
        return all(
            told().get(f"valor: process {name}") is not None and told()[f"valor: process {name}"].values
            for name in ("motion_manager", "comms_manager", VRC, "footstep_converter")
        )

    wait_until(ready, PATIENCE, "every process in /diagnostics")
    absent = told()["valor: process bag_recorder"]
    assert absent.level == DiagnosticStatus.STALE, "it was not started"
    values = {pair.key: pair.value for pair in told()["valor: process motion_manager"].values}
    assert float(values["rate [Hz]"]) > 0.0 and int(values["drops"]) >= 0 and float(values["age [s]"]) < 30.0
    diagnostics.close()


def test_every_interface_of_vigirs_that_was_kept_or_renamed_is_there(ros: RosClient) -> None:
    (table,) = tables("ViGIR's interfaces")
    assert {row["1"] for row in table} == {"kept", "renamed", "left out"}
    found = set(topics(ros)) | {name.removesuffix("/_action/send_goal") for name in services(ros)}
    for row in table:
        here = names(row["here"])
        if row["1"] == "kept" and row["ViGIR"].startswith("`/"):
            kept = names(row["ViGIR"])
            assert kept and set(kept) <= set(here), f"kept under another name: {row}"
        if row["1"] != "left out":
            assert set(here) <= found, f"not in the graph: {sorted(set(here) - found)}"
        else:
            assert not set(names(row["ViGIR"])) & found, f"left out, and yet there: {row}"


def test_the_names_of_all_control_modes_are_a_parameter(ros: RosClient) -> None:
    answer = ask(ros, GetParameters, f"/{VRC}/get_parameters", names=["allowed_control_modes"])
    assert list(answer.values[0].string_array_value) == list(ControlModeTable.load().modes)
