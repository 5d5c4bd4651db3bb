"""The state of an instance at a glance: what ``valorctl status`` shows."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, TypeVar

import bifrost
from valor_common.errors import ValorError
from valor_common.instance import Instance, Settings
from valor_common.messages import ClockStatus, ControlModeReport, MotionState
from valor_common.processes import BY_NAME
from valor_common.topics import CLOCK, CONTROL_MODE, MOTION_STATE
from valorctl import leftovers
from valorctl.health import SILENCE, Health, Listener, judge
from valorctl.supervision import ProcessInfo, Supervisor

M = TypeVar("M", bound=bifrost.Message)


@dataclass(frozen=True)
class Status:
    """One look at an instance. What nobody reports is None."""

    instance: str
    settings: Settings
    behavior: str | None
    control_mode: str | None
    clock: ClockStatus | None
    services: list[Health]

    @property
    def ready(self) -> bool:
        """Whether every process is ready."""
        return all(service.state == "ready" for service in self.services)

    def as_json(self) -> dict[str, Any]:
        """The object of ``status --json``."""
        clock = self.clock
        return {
            "instance": self.instance,
            "profile": self.settings.profile,
            "robot": self.settings.robot.name,
            "ready": self.ready,
            "behavior": self.behavior,
            "control_mode": self.control_mode,
            "clock": {
                "mode": clock.mode if clock else self.settings.clock,
                "real_time_factor": clock.real_time_factor if clock else None,
                "slip_s": clock.slip if clock else None,
            },
            "services": [
                {
                    "name": service.name,
                    "state": service.state,
                    "pid": service.pid or None,
                    "cpu_percent": service.cpu_percent,
                    "memory_mib": service.memory_mib,
                    "restarts": service.restarts,
                    "detail": service.detail,
                }
                for service in self.services
            ],
        }


def require_up(instance: Instance) -> Supervisor:
    """The instance's supervisor.

    Raises:
        ValorError: it is not up, or its supervisor is gone.
    """
    instance.settings()
    supervisor = Supervisor(instance)
    if not supervisor.answers():
        orphans = len(leftovers.processes_of(instance))
        raise ValorError(
            f"instance {instance.name!r}: its supervisor does not answer, {orphans} of its processes are left; "
            "`valorctl down` clears it away"
        )
    return supervisor


def look(instance: Instance) -> Status:
    """Look at an instance: as long as it takes to hear every process that runs, at most ``SILENCE``.

    Raises:
        ValorError: it is not up.
    """
    supervisor = require_up(instance)
    infos = supervisor.processes()
    # The table's order, the order of start.
    names = [name for name in BY_NAME if name in infos]
    with Listener(instance, names) as listener:
        state = listener.node.subscriber(MOTION_STATE.name, MotionState)
        mode = listener.node.subscriber(CONTROL_MODE.name, ControlModeReport)
        clock = listener.node.subscriber(CLOCK.name, ClockStatus)
        deadline = time.monotonic() + SILENCE
        while not _all_heard(listener, infos) and time.monotonic() < deadline:
            listener.listen(min(0.1, max(0.0, deadline - time.monotonic())))
        said = _newest(state), _newest(mode), _newest(clock)
        infos = supervisor.processes()
        now = time.monotonic()
        restarts = supervisor.restarts()
        services = [judge(infos[name], listener.words.get(name), now, restarts.get(name, 0)) for name in names]
    return Status(
        instance=instance.name,
        settings=instance.settings(),
        behavior=said[0].behavior if said[0] else None,
        control_mode=said[1].current_control_mode if said[1] else None,
        clock=said[2],
        services=services,
    )


def _all_heard(listener: Listener, infos: dict[str, ProcessInfo]) -> bool:
    """Whether every process that runs has said something."""
    return all(
        name in listener.words and listener.words[name].pid == info.pid for name, info in infos.items() if info.pid
    )


def _newest(subscriber: bifrost.Subscriber[M]) -> M | None:
    received = subscriber.latest()
    return None if received is None else received.message
