"""`controller`: report and change of the controller of the balancing robot."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rich.console import Group

from valor.common import balance_controllers
from valor.common.balance_controllers import allowed, in_control
from valor.common.behaviors import Locomotion
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import ControllerRequest, ControllerStatus
from valor.common.topics import BEHAVIOR_CHANGE, CONTROLLER, CONTROLLERS
from valor.valorctl.drive.node import join, next_message
from valor.valorctl.terminal.console import table

_TIMEOUT = 2.0  # of latched messages [s]


@dataclass(frozen=True)
class Controllers:
    """Controllers of a robot in a behavior."""

    status: ControllerStatus
    behavior: str

    def as_json(self) -> dict[str, Any]:
        """The object of ``controller --json``."""
        status = self.status
        return {
            "behavior": self.behavior,
            "in_control": in_control(status, self.behavior) or None,
            "pending": status.pending or None,
            "reason": status.reason or None,
            Locomotion.STAND: {"chosen": status.stand[0], "allowed": sorted(status.stand)},
            Locomotion.WALK: {"chosen": status.walk[0], "allowed": sorted(status.walk)},
        }

    def view(self) -> Group:
        """A table, and what is pending."""
        status, shown = self.status, table("while it", "allowed", "chosen", "in control")
        for state, names in (("stands", status.stand), ("walks", status.walk)):
            active = status.active if allowed(status, self.behavior) is names else "–"
            shown.add_row(state, ", ".join(sorted(names)), names[0], active)
        last = f"pending: {status.pending or 'none'}; last exchange: {status.reason or 'none'}"
        return Group(shown, f"behavior {self.behavior}; {last}")


def report(instance: Instance) -> Controllers:
    """The Motion Manager's latest report; raises ``ValorError`` without one."""
    with join(instance) as node:
        statuses, changes = CONTROLLERS.subscriber(node), BEHAVIOR_CHANGE.subscriber(node)
        status = next_message(CONTROLLERS, statuses, _TIMEOUT)
        return Controllers(status, next_message(BEHAVIOR_CHANGE, changes, _TIMEOUT).behavior)


def change(instance: Instance, name: str, check: Callable[[], None]) -> tuple[dict[str, Any], str]:
    """Request a controller, and wait until it is in control if the present behavior allows it.

    Returns the object of ``controller NAME --json`` and a line. ``check`` is called while waiting and may raise.
    Raises ``ValorError`` with the reason of a rejection.
    """
    began = time.monotonic()
    present = report(instance)
    with join(instance) as node:
        client = CONTROLLER.client(node)
        if now := name in allowed(present.status, present.behavior):
            statuses = CONTROLLERS.subscriber(node, queue=balance_controllers.QUEUE)
            reason = balance_controllers.exchange(client, statuses, name, check)
        else:
            reason = client.call(ControllerRequest(name), timeout=balance_controllers.REPLY_TIMEOUT).reason
    if reason:
        see = f"see `valorctl controller{Instance.option(instance.name)}`"
        raise ValorError(f"controller {name} rejected: {reason}; {see}")
    latency = time.monotonic() - began
    values = {"requested": name, "behavior": present.behavior, "reached": now, "latency_s": latency}
    if now:
        return values, f"controller {name} in control ({latency * 1e3:.0f} ms)"
    where = [f"{key}s" for key in (Locomotion.STAND, Locomotion.WALK) if name in getattr(present.status, key)]
    waits = f"it takes over when the robot {' or '.join(where)}; it is in behavior {present.behavior}"
    return values, f"controller {name} chosen: {waits}"
