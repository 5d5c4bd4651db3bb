"""The robot's end, which tells its state and obeys, and the operator's, which commands and knows how old all is."""

from __future__ import annotations

from collections.abc import Callable

from valor.link.classes import OPERATOR, ROBOT
from valor.link.codec import Codec, Receiver, Sender
from valor.link.end import HELD, End
from valor.link.errors import CodecError, SealError
from valor.link.fields import Layout
from valor.link.session import Session
from valor.link.state import RobotState

FAR = 8  # states between one and the one by which it is predicted


class RobotEnd(End):
    """Sends what ``observe`` says."""

    def __init__(
        self, session: Session, layout: Layout, observe: Callable[[], RobotState | None], now: float, fast: bool = False
    ) -> None:
        """Begin.

        Args:
            session: with the operator's end.
            layout: of the state.
            observe: the newest state, but for ``clock``; None: there is none.
            now: monotonic [s].
            fast: whether there is a fast channel, at times.
        """
        self._codec, self._observe = Codec(layout), observe
        super().__init__(session, ROBOT, now, fast)

    def _reset(self) -> None:
        super()._reset()
        self._sender = Sender(self._codec)

    def _state_acknowledged(self, counter: int) -> None:
        self._sender.acknowledged(counter)

    def _state(self, counter: int, now: float) -> bytes:
        state = self._observe()
        if state is None:
            return b""
        state.clock = round(1e3 * self.clock(now))
        return self._sender.encode(state.vector(self._codec.layout), counter)


class OperatorEnd(End):
    """Keeps the newest state.

    Attributes:
        state: the newest; None: none has come.
        states: how many have come.
    """

    def __init__(self, session: Session, layout: Layout, now: float, fast: bool = False) -> None:
        """Begin; arguments as of ``RobotEnd``."""
        self._codec = Codec(layout)
        self.state: RobotState | None = None
        self.states = 0
        super().__init__(session, OPERATOR, now, fast)

    def _reset(self) -> None:
        super()._reset()
        self._receiver = Receiver(self._codec)
        self.state = None

    def _state_arrived(self, data: bytes, counter: int, now: float) -> None:
        try:
            state = RobotState.of(self._receiver.decode(data, counter), self._codec.layout)
        except CodecError as error:
            raise SealError(str(error)) from None
        if not 0 < Codec.distance(data) <= FAR:  # the sender knows of none that is near: a state costs twice as much
            self._acknowledge_by(max(now, self._acknowledged_at + HELD))
        self._newest = max(self._newest, counter)
        self.states += 1
        self.other.arrived(state.clock / 1e3, now)
        if self.state is None or state.clock > self.state.clock:
            self.state = state

    def age(self, now: float) -> float:
        """Of the state, at most [s]; inf: there is none, or nothing is known."""
        return self.other.age(self.state.clock / 1e3, now) if self.state else float("inf")
