"""The state of an instance at a glance: what ``valorctl status`` shows."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import bifrost
from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.messages import ClockStatus, ControlModeReport, MotionState
from valor.common.processes import BY_NAME, RECORDER
from valor.common.topics import CLOCK, CONTROL_MODE, MOTION_STATE
from valor.valorctl import leftovers
from valor.valorctl.health import SILENCE, Health, Listener, judge
from valor.valorctl.recording_report import Glance, glance
from valor.valorctl.supervision import ProcessInfo, Supervisor


@dataclass(frozen=True)
class Status:
    """One look at an instance. What nobody reports is None."""

    instance: str
    settings: Settings
    behavior: str | None
    control_mode: str | None
    clock: ClockStatus | None
    services: list[Health]
    recording: Glance | None  # None: the profile has no recorder

    @property
    def ready(self) -> bool:
        """Whether every process is ready."""
        return all(service.state == "ready" for service in self.services)

    @property
    def factor_since_start(self) -> float | None:
        """Robot time to wall time since the first Motor; None: nothing has passed, or no pace was set.

        What robot time lacks against its schedule is slip.
        """
        settings, clock = self.settings, self.clock
        pace = settings.real_time_factor if clock is not None and clock.mode == "lockstep" else 1.0
        if clock is None or clock.time <= 0 or not pace:
            return None
        passed = clock.time * 1e-9
        return pace * passed / (passed + clock.slip)

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
                "real_time_factor_since_start": self.factor_since_start,
                "slip_s": clock.slip if clock else None,
            },
            "recording": self.recording.as_json() if self.recording else None,
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
    running = {name for name, info in infos.items() if info.pid}
    with Listener(instance, names) as listener:
        reports = _Reports(listener.node)
        deadline = time.monotonic() + SILENCE
        while time.monotonic() < deadline:
            reports.take()
            if _all_heard(listener, infos) and reports.complete(running):
                break
            listener.listen(0.05)
        infos = supervisor.processes()
        restarts = supervisor.restarts()
        now = time.monotonic()
        services = [judge(infos[name], listener.words.get(name), now, restarts.get(name, 0)) for name in names]
    return Status(
        instance=instance.name,
        settings=instance.settings(),
        behavior=reports.motion_state.behavior if reports.motion_state else None,
        control_mode=reports.control_mode.current_control_mode if reports.control_mode else None,
        clock=reports.clock,
        services=services,
        recording=glance(instance, instance.settings().recording.bounds) if RECORDER in names else None,
    )


class _Reports:
    """The newest of what is reported besides the processes' own state."""

    def __init__(self, node: bifrost.Node) -> None:
        self._states = node.subscriber(MOTION_STATE.name, MotionState)
        self._modes = node.subscriber(CONTROL_MODE.name, ControlModeReport)
        self._clocks = node.subscriber(CLOCK.name, ClockStatus)
        self.motion_state: MotionState | None = None
        self.control_mode: ControlModeReport | None = None
        self.clock: ClockStatus | None = None

    def take(self) -> None:
        """Take in what has come."""
        if state := self._states.latest():
            self.motion_state = state.message
        if mode := self._modes.latest():
            self.control_mode = mode.message
        if clock := self._clocks.latest():
            self.clock = clock.message

    def complete(self, running: set[str]) -> bool:
        """Whether all that the running processes report has come."""
        return (
            (self.motion_state is not None or MOTION_STATE.publisher not in running)
            and (self.control_mode is not None or CONTROL_MODE.publisher not in running)
            and (self.clock is not None or CLOCK.publisher not in running)
        )


def _all_heard(listener: Listener, infos: dict[str, ProcessInfo]) -> bool:
    """Whether every process that runs has said something."""
    return all(
        name in listener.words and listener.words[name].pid == info.pid for name, info in infos.items() if info.pid
    )
