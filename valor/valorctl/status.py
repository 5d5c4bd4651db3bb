"""The state of an instance at a glance: what ``valorctl status`` shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from valor.common.behaviors import Behavior, ControlMode
from valor.common.instance import Instance, Settings
from valor.common.messages import ClockStatus
from valor.common.processes import BY_NAME, Process
from valor.valorctl.health import Health
from valor.valorctl.recording_report import Glance
from valor.valorctl.supervision import HostState

WAY_OUT: Mapping[str, str] = {
    Behavior.FALL: "get-up",
    Behavior.FREEZE: f"mode {ControlMode.STAND_PREP}",
    Behavior.SOFT_STOP: f"mode {ControlMode.STAND}",
}
"""The verb that leads out of a behavior in which the robot obeys nothing else."""


@dataclass(frozen=True)
class Condition:
    """How the robot came to its behavior."""

    reason: str
    since: float  # robot time [s]
    began: float  # wall clock [s]
    bag: Path | None  # the recording of its beginning, as far as there is one


@dataclass(frozen=True)
class Status:
    """One look at an instance. What nobody reports is None."""

    instance: str
    settings: Settings
    behavior: str | None
    control_mode: str | None
    clock: ClockStatus | None
    services: list[Health]
    recording: Glance | None = None  # None: the profile has no recorder
    condition: Condition | None = None
    hosts: Sequence[HostState] = ()  # none: all is on this computer
    supervised: bool = True  # whether supervisord answers, which restarts what ends
    beyond_age: float | None = None  # at most, of what the link told of the robot's side [s]; None: nothing

    @property
    def ready(self) -> bool:
        """Whether every process is ready."""
        return all(service.state == "ready" for service in self.services)

    @property
    def fallen(self) -> bool | None:
        """Whether the robot has fallen."""
        return None if self.behavior is None else self.behavior == Behavior.FALL

    @property
    def way_out(self) -> str | None:
        """The command that leads out of a behavior in which the robot obeys nothing else."""
        verb = WAY_OUT.get(self.behavior or "")
        return verb and f"valorctl {verb}{Instance.option(self.instance)}"

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
        clock, condition = self.clock, self.condition
        return {
            "instance": self.instance,
            "profile": self.settings.profile,
            "robot": self.settings.robot.name,
            "ros_commands": self.settings.ros_commands,
            "ready": self.ready,
            "supervised": self.supervised,
            "behavior": self.behavior,
            "reason": condition and condition.reason,
            "since_s": condition and condition.since,
            "began": condition and condition.began,
            "fallen": self.fallen,
            "way_out": self.way_out,
            "bag": condition and condition.bag and str(condition.bag),
            "control_mode": self.control_mode,
            "beyond_age_s": self.beyond_age,
            "clock": {
                "mode": clock.mode if clock else self.settings.clock,
                "time_s": clock.time * 1e-9 if clock else None,
                "real_time_factor": clock.real_time_factor if clock else None,
                "real_time_factor_since_start": self.factor_since_start,
                "slip_s": clock.slip if clock else None,
            },
            "recording": self.recording.as_json() if self.recording else None,
            "hosts": [asdict(host) for host in self.hosts],
            "services": [
                asdict(service) | {"pid": service.pid or None} | _row(BY_NAME[service.name])
                for service in self.services
            ],
        }


def _row(process: Process) -> dict[str, Any]:
    """What the table of processes says."""
    return {
        "description": process.description,
        "needs": [*process.needs, *process.after],
        "cpu_budget_percent": process.cpu_budget,
        "memory_budget_mib": process.memory_budget,
    }
