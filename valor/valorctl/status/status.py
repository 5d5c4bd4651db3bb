"""``status``: the state of an instance from supervisord, reports of processes, and latched topics."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import bifrost
from valor.bags import recordings
from valor.common.balance_controllers import in_control
from valor.common.behaviors import Behavior, ControlMode
from valor.common.errors import ValorError
from valor.common.instance import Instance, Settings
from valor.common.messages import BehaviorChange, ClockStatus
from valor.common.processes import BY_NAME, RECORDER
from valor.common.topics import BEHAVIOR_CHANGE, CLOCK, CONTROL_MODE, CONTROLLERS, FROZEN, PAUSED, Topic
from valor.common.viewing import page_port, url
from valor.valorctl.drive.getting_up import simulated
from valor.valorctl.instance.running import processes_found, supervising, unsupervised
from valor.valorctl.instance.supervision import HostState, ProcessInfo, SupervisorError
from valor.valorctl.recordings.recording_report import Glance, glance
from valor.valorctl.status.health import REPORT_TIMEOUT, Health, Listener, judge

WAY_OUT: Mapping[str, str] = {
    Behavior.FALL: "get-up",
    Behavior.FREEZE: f"mode {ControlMode.STAND_PREP}",
    Behavior.SOFT_STOP: f"mode {ControlMode.STAND}",
}
"""The verb that ends a behavior in which the robot rejects other commands."""
UPTIME_STEP = 1.0  # resolution of supervisord's uptime [s]
TOPICS: tuple[Topic[Any], ...] = (BEHAVIOR_CHANGE, FROZEN, CONTROLLERS, CONTROL_MODE, CLOCK)


@dataclass(frozen=True)
class Condition:
    """Start of the current behavior."""

    reason: str  # of the change of behavior
    since: float  # time of the change, robot time [s]
    began: float  # time of the change, wall clock [s]
    bag: Path | None  # recording of the change, if any


@dataclass(frozen=True)
class Status:
    """State of an instance. None: not reported."""

    instance: str
    settings: Settings
    behavior: str | None
    control_mode: str | None
    clock: ClockStatus | None
    services: list[Health]
    recording: Glance | None = None  # None: no recorder on this computer
    condition: Condition | None = None
    hosts: Sequence[HostState] = ()  # empty: all processes run on this computer
    frozen: Sequence[str] = ()  # limbs frozen while the rest of the robot moves
    controller: str | None = None  # that balances the robot; None also if none does
    supervised: bool = True  # whether supervisord responds, which restarts processes

    @property
    def ready(self) -> bool:
        """True if every process is ready."""
        return all(service.state == "ready" for service in self.services)

    @property
    def paused(self) -> bool:
        """Whether robot time is paused."""
        return self.clock is not None and self.clock.mode == PAUSED

    @property
    def fallen(self) -> bool | None:
        """True if the robot has fallen."""
        return None if self.behavior is None else self.behavior == Behavior.FALL

    @property
    def resettable(self) -> bool:
        """Whether ``reset`` can place the robot."""
        return simulated(self.settings, [service.name for service in self.services])

    @property
    def way_out(self) -> str | None:
        """The command that ends a behavior in which the robot rejects other commands."""
        verb = WAY_OUT.get(self.behavior or "")
        if self.paused:
            verb = "time resume"
        elif self.fallen and self.resettable:
            verb = "reset"
        return verb and f"valorctl {verb}{Instance.option(self.instance)}"

    @property
    def page(self) -> str | None:
        """Address of the operator's page; None if it is not served."""
        served = any(service.name == "operator_stop" and service.pid for service in self.services)
        return url(page_port(self.settings)) if served else None

    @property
    def factor_since_start(self) -> float | None:
        """Ratio of robot time to wall time since the first Motor; None without elapsed time or a real-time factor."""
        settings, clock = self.settings, self.clock
        factor = settings.real_time_factor if clock is not None and clock.mode == "lockstep" else 1.0
        if clock is None or clock.time <= 0 or not factor:
            return None
        passed = clock.time * 1e-9
        return factor * passed / (passed + clock.slip)

    def as_json(self) -> dict[str, Any]:
        """The object of ``status --json``."""
        clock, condition = self.clock, self.condition
        return {
            "instance": self.instance,
            "profile": self.settings.profile,
            "robot": self.settings.robot.name,
            "ros_commands": self.settings.ros_commands,
            "page": self.page,
            "ready": self.ready,
            "supervised": self.supervised,
            "behavior": self.behavior,
            "reason": condition and condition.reason,
            "since_s": condition and condition.since,
            "began": condition and condition.began,
            "fallen": self.fallen,
            "frozen": list(self.frozen),
            "way_out": self.way_out,
            "bag": condition and condition.bag and str(condition.bag),
            "control_mode": self.control_mode,
            "controller": self.controller,
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
                asdict(service)
                | {
                    "pid": service.pid or None,
                    "description": process.description,
                    "needs": [*process.needs, *process.after],
                    "cpu_budget_percent": process.cpu_budget,
                    "memory_budget_mib": process.memory_budget,
                }
                for service in self.services
                for process in [BY_NAME[service.name]]
            ],
        }


class Watch:
    """A source of ``Status``. A context manager.

    It waits for latched or fast topics only, not for those published once a second. None of them has arrays, so NumPy
    is not imported.
    """

    def __init__(self, instance: Instance) -> None:
        """Subscribe. Raises ``ValorError``: the instance is not up, or has crashed."""
        self._instance = instance
        self._settings = instance.settings()
        self._supervisor = supervising(instance, self._settings)
        infos, _ = self._processes()
        self._names = [name for name in BY_NAME if name in infos]  # in the order of start
        self._listener = Listener(instance, self._names)
        self._subscribers = {topic.name: topic.subscriber(self._listener.node) for topic in TOPICS}
        self._received: dict[str, bifrost.Received[Any] | None] = dict.fromkeys(self._subscribers)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._listener.close()
        self._supervisor.close()

    def look(self) -> Status:
        """The current state, with the reports expected; raises ``ValorError`` if no process runs any more."""
        listener, received = self._listener, self._received
        received[CONTROL_MODE.name] = received[CLOCK.name] = None  # may have changed since the last call
        infos, supervised = self._processes()
        listener.listen(0.0)  # messages since the last call
        deadline = time.monotonic() + REPORT_TIMEOUT
        while True:
            for name, subscriber in self._subscribers.items():
                received[name] = subscriber.latest() or received[name]
            missing = [topic for topic in TOPICS if received[topic.name] is None]
            reports = listener.reports
            mute = {n for n, info in infos.items() if info.pid and (n not in reports or reports[n].pid != info.pid)}
            ready = {n for n, info in infos.items() if info.pid and n not in mute and reports[n].state == "ready"}
            if not listener.expected(mute) | ready.intersection(topic.owner for topic in missing):
                break
            if time.monotonic() > deadline:
                break
            listener.listen(0.05, [self._subscribers[topic.name] for topic in missing])
        now, clock = time.monotonic(), received[CLOCK.name]
        paused = clock is not None and clock.message.mode == PAUSED
        restarts = self._supervisor.restarts()
        change = self._change(infos.get(BEHAVIOR_CHANGE.owner), now)
        records = RECORDER in self._settings.processes_here(self._names)
        return Status(
            instance=self._instance.name,
            settings=self._settings,
            behavior=change.message.behavior if change else None,
            control_mode=mode.message.current_control_mode if (mode := received[CONTROL_MODE.name]) else None,
            clock=clock.message if clock else None,
            services=[
                judge(infos[name], listener.reports.get(name), now, restarts.get(name, 0), paused)
                for name in self._names
                if name in infos
            ],
            recording=glance(self._instance, self._settings.recording.bounds) if records else None,
            hosts=self._supervisor.hosts(),
            condition=self._condition(change) if change else None,
            frozen=frozen.message.limbs if change and (frozen := received[FROZEN.name]) else (),
            controller=self._controller(change),
            supervised=supervised,
        )

    def _controller(self, change: bifrost.Received[BehaviorChange] | None) -> str | None:
        status = self._received[CONTROLLERS.name]
        return in_control(status.message, change.message.behavior) or None if status and change else None

    def _change(self, info: ProcessInfo | None, now: float) -> bifrost.Received[BehaviorChange] | None:
        """The last change of behavior, if it is from the current run of a process that still reports."""
        change, report = self._received[BEHAVIOR_CHANGE.name], self._listener.reports.get(BEHAVIOR_CHANGE.owner)
        if change is None or report is None or info is None or report.pid != info.pid:
            return None
        if now - report.received > REPORT_TIMEOUT:
            return None
        return change if now - change.stamp * 1e-9 <= info.uptime + UPTIME_STEP else None

    def _condition(self, change: bifrost.Received[BehaviorChange]) -> Condition:
        began = time.time() - (time.monotonic_ns() - change.stamp) * 1e-9
        bag = recordings.holding(self._instance.folder, began)
        return Condition(change.message.reason, change.message.time * 1e-9, began, bag)

    def _processes(self) -> tuple[dict[str, ProcessInfo], bool]:
        """The processes, and whether supervisord reported them; otherwise they are found by their environment."""
        try:
            return self._supervisor.processes(), True
        except SupervisorError:
            found = processes_found(self._instance)
            if not found:
                self._instance.settings()  # raises if the instance was taken down since the start of the call
                raise ValorError(unsupervised(self._instance, 0)) from None
            return found, False
