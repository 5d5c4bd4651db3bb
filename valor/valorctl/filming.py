"""Films from the command line: of a recording, and of what a verb lets the robot do."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from valor.common.errors import ValorError
from valor.common.instance import Instance
from valor.common.messages import Proprioceptor
from valor.common.topics import GROUND_TRUTH, MOTION_STATE, PROPRIOCEPTOR
from valor.valorctl.console import bar, complain, progress, say
from valor.valorctl.interruption import InterruptedBySignalError, Interruption
from valor.valorctl.node import join

if TYPE_CHECKING:
    from valor.analysis.film.film import Film, Order
    from valor.analysis.film.moments import Moments

_TOPICS = (PROPRIOCEPTOR, MOTION_STATE, GROUND_TRUTH)
_LOOK = 0.02  # between two looks at what came [s]
_QUEUE = 5000  # messages that may come between two looks

Read = Callable[[float], None]  # called with how far a recording has been read [s]
Drawn = Callable[[int, int], None]  # called with how many pictures are done, and of how many


def shoot(bag: Path, file: Path, order: Order, *, quiet: bool = False) -> Film:
    """Make a film of a recording while a person sees how it goes on; nothing is left if it is interrupted.

    Raises:
        ValorError: see ``film.make``.
    """
    from valor.analysis.film import film

    return _shown(lambda read, drawn: film.make(bag, file, order, read, drawn), quiet)


@contextlib.contextmanager
def filmed(instance: Instance, file: Path | None, *, quiet: bool = False) -> Iterator[None]:
    """Film what the robot does inside, also if that fails; drawn when it is over, unless it was interrupted.

    Args:
        instance: a running system.
        file: where the film goes; None: none is made.
        quiet: nothing is said of it.

    Raises:
        ConfigurationError: at once: the file's ending is none of those known.
        ValorError: nothing was heard; the file cannot be written.
    """
    if file is None:
        yield
        return
    from valor.analysis.film import film, frames

    order = film.Order(overlays=(frames.MODES,))
    failure: ValorError | None = None
    with _Witness(instance, order.step(file)) as witness:
        try:
            yield
        except InterruptedBySignalError:
            raise
        except ValorError as error:
            failure = error
    settings = instance.settings()
    try:
        found = witness.moments()
        subject = film.Subject(settings.robot, (settings.world, settings.seed))
        _shown(lambda _, drawn: film.develop(found, subject, file, order, drawn), quiet)
    except ValorError as error:
        if failure is None:
            raise
        complain(str(error))
    if failure is not None:
        raise failure


def describe(made: Film) -> str:
    """One line."""
    size = made.file.stat().st_size
    return f"{made.file}: {made.duration:.1f} s, {size / 1e6:.1f} MB; the robot where {made.base} has it"


def _shown(make: Callable[[Read, Drawn], Film], quiet: bool) -> Film:
    with contextlib.ExitStack() as stack:
        shown, interruption = stack.enter_context(progress()), stack.enter_context(Interruption())
        fill: list[Callable[[float], None]] = []

        def read(seconds: float) -> None:
            interruption.check()
            if not quiet:
                shown.waiting(f"reading: {seconds:.0f} s")

        def drawn(pictures: int, whole: int) -> None:
            interruption.check()
            if quiet:
                return
            if not fill:
                shown.clear()
                fill.append(stack.enter_context(bar("drawing", whole, "pictures", digits=0)))
            fill[0](pictures)

        made = make(read, drawn)
    for line in made.notices:
        complain(line)
    if not quiet:
        say(describe(made))
    return made


class _Witness:
    """Hears a robot while it does something, and keeps what pictures need.

    Args:
        instance: a running system.
        step: between the pictures [s].
    """

    def __init__(self, instance: Instance, step: float) -> None:
        self._instance, self._step = instance, step
        self._samplers: dict[str, Any] = {}
        self._first = self._newest = -1.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="witness", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._thread.join()

    def moments(self) -> Moments:
        """What was heard.

        Raises:
            ValorError: nothing was.
        """
        from valor.analysis.film.moments import gather

        if self._first < 0.0:
            raise ValorError(f"nothing to film: {PROPRIOCEPTOR.owner} was silent, no {PROPRIOCEPTOR.name}")
        return gather(self._samplers, self._first, 0.0, self._newest, self._step)

    def _listen(self) -> None:
        with join(self._instance) as node:
            from valor.analysis.recording import recorded

            heard = [(recorded(topic), topic.subscriber(node, queue=_QUEUE)) for topic in _TOPICS]
            while not self._over.wait(_LOOK):
                for name, subscriber in heard:
                    for received in subscriber.drain():
                        self._hear(name, received.message)

    def _hear(self, name: str, message: Any) -> None:
        from valor.analysis.film.moments import Sampler

        time = 1e-9 * message.time
        if isinstance(message, Proprioceptor):
            self._first = time if self._first < 0.0 else self._first
            self._newest = max(self._newest, time)
        if self._first >= 0.0:
            if name not in self._samplers:
                self._samplers[name] = Sampler(self._first, self._step)
            self._samplers[name].hear(time, message)
