"""ROS parameters with description and range; rclpy rejects values of another type or out of range."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from valor.common.errors import ConfigurationError

T = TypeVar("T", bool, int, float, str, list[str])


@dataclass(frozen=True)
class Range:
    """Range of a number."""

    lowest: float
    highest: float


class Parameters:
    """Declares the node's parameters, and reports changes."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._changes: dict[str, Callable[[Any], None]] = {}
        node.add_post_set_parameters_callback(self._changed)

    def declare(
        self,
        name: str,
        default: T,
        description: str,
        values: Range | None = None,
        on_change: Callable[[Any], None] | None = None,
    ) -> T:
        """Declare a parameter and read it; it is read-only without ``on_change``, called in the ROS thread.

        Raises ConfigurationError: it was set at start to a value of another type or out of range.
        """
        descriptor = ParameterDescriptor(description=description, read_only=on_change is None)
        if values and isinstance(default, int):
            descriptor.integer_range = [IntegerRange(from_value=int(values.lowest), to_value=int(values.highest))]
        elif values:
            descriptor.floating_point_range = [FloatingPointRange(from_value=values.lowest, to_value=values.highest)]
        try:
            parameter: Parameter = self._node.declare_parameter(name, default, descriptor)
        except Exception as error:
            expected = f"{values.lowest:g} to {values.highest:g}" if values else f"as {default!r}"
            raise ConfigurationError(f"ROS parameter {name}: {error}; expected {expected}") from None
        if on_change:
            self._changes[name] = on_change
        value: T = parameter.value
        return value

    def reject_changes(self, reason: str) -> None:
        """Reject every change from now on."""
        rejected = SetParametersResult(successful=False, reason=reason)
        self._node.add_on_set_parameters_callback(lambda _: rejected)

    def _changed(self, parameters: Sequence[Parameter]) -> None:
        for parameter in parameters:
            if on_change := self._changes.get(parameter.name):
                on_change(parameter.value)
