"""A node's life, time and arguments, in a process that has no robot."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from harness.instance import RunningInstance
from valor.common.errors import ConfigurationError
from valor.common.instance import Settings
from valor.ros.node import ProcessNode, RosSide

pytestmark = pytest.mark.portable


@pytest.fixture
def settings(instance: RunningInstance) -> Settings:
    return instance.settings


def joined(settings: Settings, *arguments: str, variant: str = "simulation", **options: object) -> RosSide:
    changed = Settings(robot=Path("escher"), ros_domain_id=settings.ros_domain_id, variant=variant)  # type: ignore[arg-type]
    return RosSide("somebody", changed, {}, arguments, **options)  # type: ignore[arg-type]


@pytest.fixture
def side(settings: Settings) -> Iterator[RosSide]:
    made = joined(settings, node=lambda name, context: ProcessNode(name, context, True))
    yield made
    made.close()


def test_a_process_with_robot_time_shows_it_and_subscribes_to_no_clock(side: RosSide) -> None:
    side.node.set_time(1_500_000_000)
    assert side.node.get_clock().now().nanoseconds == 1_500_000_000 and not side.node.count_subscribers("/clock")


@pytest.mark.parametrize(
    ("variant", "arguments", "expected"),
    [
        ("simulation", (), True),
        ("hardware", (), False),
        ("simulation", ("--ros-args", "-p", "use_sim_time:=false"), False),
        ("hardware", ("--ros-args", "-p", "use_sim_time:=true"), True),
    ],
)
def test_sim_time_is_that_of_the_variant_unless_an_argument_states_otherwise(
    settings: Settings, variant: str, arguments: tuple[str, ...], expected: bool
) -> None:
    side = joined(settings, *arguments, variant=variant)
    try:
        assert side.node.get_parameter("use_sim_time").value is expected
    finally:
        side.close()


@pytest.mark.parametrize("arguments", [("faster",), ("--ros-args", "-r", "::"), ("--ros-args", "--nonsense")])
def test_other_arguments_are_refused_by_name(settings: Settings, arguments: tuple[str, ...]) -> None:
    with pytest.raises(ConfigurationError, match=arguments[-1]):
        joined(settings, *arguments)


def test_a_node_is_active_while_it_can_work_and_finalized_at_the_end(settings: Settings) -> None:
    states: list[str] = []

    def watched(callback: str) -> Any:
        def called(node: ProcessNode, state: object) -> object:
            states.append(callback)
            return getattr(ProcessNode, callback)(node, state)

        return called

    names = ("on_configure", "on_activate", "on_deactivate", "on_shutdown")
    configured, activated, deactivated, shut_down = names
    watching: Any = type("Watched", (ProcessNode,), {name: watched(name) for name in names})
    side = joined(settings, node=watching)
    side.life.configure()
    side.serve_pending()
    assert states == [configured]
    for ready in (True, True, False, True):
        side.life.set_ready(ready, "something")
        side.serve_pending()
    side.close()
    assert states == [configured, activated, deactivated, activated, deactivated, shut_down]
