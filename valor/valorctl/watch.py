"""``status``: looks at an instance, once or again and again, by what its processes say of themselves."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

import bifrost
from valor.bags import recordings
from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.linking import robots_hosts
from valor.common.messages import BehaviorChange, ClockStatus, ControlModeReport
from valor.common.processes import BY_NAME, RECORDER
from valor.common.topics import BEHAVIOR_CHANGE, CLOCK, CONTROL_MODE, Topic
from valor.valorctl.console import rich_console, say_json
from valor.valorctl.health import SILENCE, Listener, judge
from valor.valorctl.presence import processes_found, supervising, unsupervised
from valor.valorctl.recording_report import Glance, glance
from valor.valorctl.status import Condition, Status
from valor.valorctl.supervision import ProcessInfo, SupervisorError

if TYPE_CHECKING:
    from valor.valorctl.hosts.beyond import Beyond

UPTIME_STEP = 1.0  # supervisord counts whole seconds [s]


def run(instance: Instance, json: bool) -> None:
    """The verb: look at an instance once, and say what there is.

    Raises:
        ValorError: it is not up, or nothing restarts its processes.
    """
    seen = look(instance)
    if json:
        say_json(seen.as_json())
    else:
        from valor.valorctl.status_view import view

        rich_console().print(view(seen))
    if not seen.supervised:
        raise ValorError(unsupervised(instance, len(seen.services)))


def look(instance: Instance) -> Status:
    """Look at an instance once.

    Raises:
        ValorError: it is not up, or has crashed as a whole.
    """
    with Watch(instance) as watch:
        return watch.look()


class Watch:
    """Hears what an instance's processes say. A context manager.

    All of it comes from latched topics, or at a high rate: whoever asks waits for nothing that comes once a second, nor
    for NumPy, as none of it has arrays.
    """

    def __init__(self, instance: Instance) -> None:
        """Begin to listen.

        Raises:
            ValorError: it is not up, or has crashed as a whole.
        """
        self._instance = instance
        self._settings = instance.settings()
        self._supervisor = supervising(instance, self._settings)
        infos, _ = self._processes()
        # The table's order, the order of start.
        self._names = [name for name in BY_NAME if name in infos]
        self._listener = Listener(instance, self._names)
        self._reports = _Reports(self._listener.node)
        self._beyond: Beyond | None = None
        if robots_hosts(self._settings):
            from valor.valorctl.hosts.beyond import Beyond

            self._beyond = Beyond(instance, self._settings)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._beyond is not None:
            self._beyond.close()
        self._listener.close()
        self._supervisor.close()

    def look(self) -> Status:
        """What there is: waits for what is known to come, at most ``SILENCE``.

        Raises:
            ValorError: nothing of it runs any more.
        """
        listener, reports = self._listener, self._reports
        reports.forget()
        infos, supervised = self._processes()
        listener.listen(0.0)  # what has come since the last look
        deadline = time.monotonic() + SILENCE
        while True:
            reports.take()
            words = listener.words
            mute = {n for n, info in infos.items() if info.pid and (n not in words or words[n].pid != info.pid)}
            ready = {n for n, info in infos.items() if info.pid and n not in mute and words[n].state == "ready"}
            awaited = listener.may_speak(mute) | reports.awaited(ready)
            if not awaited or time.monotonic() > deadline:
                break
            listener.listen(0.05, reports.subscribers)
        now = time.monotonic()
        restarts = self._supervisor.restarts()
        mode, clock = reports.control_mode, reports.clock
        change = self._change(infos.get(BEHAVIOR_CHANGE.owner), now)
        seen = Status(
            instance=self._instance.name,
            settings=self._settings,
            behavior=change.message.behavior if change else None,
            control_mode=mode.current_control_mode if mode else None,
            clock=clock,
            services=[
                judge(infos[name], listener.words.get(name), now, restarts.get(name, 0))
                for name in self._names
                if name in infos
            ],
            recording=self._recording(),
            hosts=self._supervisor.hosts(),
            condition=self._condition(change) if change else None,
            supervised=supervised,
        )
        return seen if self._beyond is None else self._with_robot(seen, self._beyond)

    def _with_robot(self, seen: Status, beyond: Beyond) -> Status:
        """With what the robot's side of the link tells of itself."""
        from valor.valorctl.hosts.beyond import BeyondError, fares

        told, age, problem = None, None, ""
        try:
            told, age = beyond.status()
        except BeyondError as error:
            problem = str(error)
        services, hosts = fares(self._settings, told, problem)
        order = list(BY_NAME)
        return replace(
            seen,
            behavior=told.behavior if told else None,
            control_mode=told.control_mode if told else None,
            services=sorted([*seen.services, *services], key=lambda each: order.index(each.name)),
            hosts=[*hosts, *seen.hosts],
            beyond_age=age,
        )

    def _recording(self) -> Glance | None:
        """Of a recorder on this computer."""
        if RECORDER not in self._settings.processes_here(self._names):
            return None
        return glance(self._instance, self._settings.recording.bounds)

    def _change(self, info: ProcessInfo | None, now: float) -> bifrost.Received[BehaviorChange] | None:
        """The last change of behavior, if the process that runs now made it, and is not silent."""
        change, word = self._reports.change, self._listener.words.get(BEHAVIOR_CHANGE.owner)
        if change is None or word is None or info is None or word.pid != info.pid or now - word.heard > SILENCE:
            return None
        return change if now - change.stamp * 1e-9 <= info.uptime + UPTIME_STEP else None

    def _condition(self, change: bifrost.Received[BehaviorChange]) -> Condition:
        began = time.time() - (time.monotonic_ns() - change.stamp) * 1e-9
        bag = recordings.holding(self._instance.folder, began)
        return Condition(change.message.reason, change.message.time * 1e-9, began, bag)

    def _processes(self) -> tuple[dict[str, ProcessInfo], bool]:
        """Those of the instance, and whether supervisord told of them; else they are found by their environment."""
        try:
            return self._supervisor.processes(), True
        except SupervisorError:
            found = processes_found(self._instance)
            if not found:
                self._instance.settings()  # gone where it was taken down meanwhile, and told so
                raise ValorError(unsupervised(self._instance, 0)) from None
            return found, False


class _Reports:
    """The newest of what is reported besides the processes' own state."""

    def __init__(self, node: bifrost.Node) -> None:
        self._modes = CONTROL_MODE.subscriber(node)
        self._clocks = CLOCK.subscriber(node)
        self._changes = BEHAVIOR_CHANGE.subscriber(node)
        self.change: bifrost.Received[BehaviorChange] | None = None
        self.control_mode: ControlModeReport | None = None
        self.clock: ClockStatus | None = None

    @property
    def subscribers(self) -> tuple[bifrost.Subscriber[Any], ...]:
        """To wait for those of which nothing has come."""
        return tuple(subscriber for _, subscriber, heard in self._heard if heard is None)

    @property
    def _heard(self) -> tuple[tuple[Topic[Any], bifrost.Subscriber[Any], object], ...]:
        return (
            (BEHAVIOR_CHANGE, self._changes, self.change),
            (CONTROL_MODE, self._modes, self.control_mode),
            (CLOCK, self._clocks, self.clock),
        )

    def forget(self) -> None:
        """What was reported before is not what is reported now."""
        self.control_mode = self.clock = None

    def take(self) -> None:
        """Take in what has come."""
        if mode := self._modes.latest():
            self.control_mode = mode.message
        if clock := self._clocks.latest():
            self.clock = clock.message
        self.change = self._changes.latest() or self.change

    def awaited(self, ready: set[str]) -> set[str]:
        """Those of the processes that are ready whose report has not come."""
        return {topic.owner for topic, _, heard in self._heard if heard is None and topic.owner in ready}
