"""Robot's end, which sends states and pictures, and operator's end, which receives them and bounds their age."""

from collections.abc import Callable

from valor.common.instance import LINK_RATE
from valor.link.classes import rates
from valor.link.codec import Codec, Receiver, Sender
from valor.link.endpoint import ACKNOWLEDGEMENT_DELAY, Channel, LinkEndpoint
from valor.link.errors import CodecError, SealError
from valor.link.fields import Layout
from valor.link.picture import Picture, PictureReceiver, PictureSender
from valor.link.session import Session
from valor.link.state import RobotState

FAR = 8  # distance of a reference frame, in datagrams, from which on a state costs too many bytes


class RobotEndpoint(LinkEndpoint):
    """Sends the states of ``observe`` and the pictures of ``picture``."""

    def __init__(
        self,
        session: Session,
        layout: Layout,
        observe: Callable[[], RobotState | None],
        now: float,
        *,
        fast: bool = False,
        picture: Callable[[], Picture | None] = lambda: None,
        rate: float = LINK_RATE,
    ) -> None:
        """Start at the monotonic time ``now`` [s]; ``fast``: there is a fast channel; ``rate``: of the slow one [B/s].

        ``observe`` returns the latest state without ``clock``, ``picture`` the latest picture; None if there is none.
        """
        self._codec, self._observe, self._latest_picture = Codec(layout), observe, picture
        super().__init__(session, rates(rate, True), now, fast)

    def _reset(self) -> None:
        super()._reset()
        self._sender = Sender(self._codec)
        self._pictures = PictureSender(self._latest_picture)

    def _state_acknowledged(self, counter: int) -> None:
        self._sender.acknowledged(counter)

    def _picture_received(self, body: bytes) -> None:
        self._pictures.acknowledged(body)

    def _picture_records(self, now: float) -> list[bytes]:
        return self._pictures.turn(now)

    def turn(self, now: float) -> list[tuple[Channel, bytes]]:
        """Datagrams to send now; ``now``: monotonic [s]."""
        if not self.fast(now):
            self._pictures.restart()
        return super().turn(now)

    def _state(self, counter: int, now: float) -> bytes:
        state = self._observe()
        if state is None:
            return b""
        state.clock = round(1e3 * self.clock(now))
        return self._sender.encode(state.vector(self._codec.layout), counter)


class OperatorEndpoint(LinkEndpoint):
    """Receives states and pictures: ``state`` and ``picture``, the latest of this session, or None."""

    def __init__(
        self, session: Session, layout: Layout, now: float, fast: bool = False, *, rate: float = LINK_RATE
    ) -> None:
        """Start; arguments as for ``RobotEndpoint``."""
        self._codec = Codec(layout)
        self.state: RobotState | None = None
        self.states = 0  # received
        super().__init__(session, rates(rate, False), now, fast)

    def _reset(self) -> None:
        super()._reset()
        self._receiver = Receiver(self._codec)
        self.state = None
        self._pictures = PictureReceiver()
        self.picture: Picture | None = None

    def _picture_received(self, body: bytes) -> None:
        self.picture = self._pictures.take(body) or self.picture

    def _picture_records(self, now: float) -> list[bytes]:
        body = self._pictures.acknowledgement()
        return [body] if body else []

    def _state_received(self, data: bytes, counter: int, now: float) -> None:
        try:
            state = RobotState.of(self._receiver.decode(data, counter), self._codec.layout)
        except CodecError as error:
            raise SealError(str(error)) from None
        if not 0 < Codec.distance(data) <= FAR:  # a near reference halves the bytes: acknowledge soon
            self._acknowledge_by(max(now, self._acknowledged_at + ACKNOWLEDGEMENT_DELAY))
        self._latest_counter = max(self._latest_counter, counter)
        self.states += 1
        self.other.received(state.clock / 1e3, now)
        if self.state is None or state.clock > self.state.clock:
            self.state = state

    def age(self, now: float) -> float:
        """Upper bound of the state's age [s]; inf if there is none."""
        return self.other.age(self.state.clock / 1e3, now) if self.state else float("inf")

    def picture_age(self, now: float) -> float:
        """Upper bound of the picture's age [s]; inf if there is none."""
        return self.other.age(self.picture.clock / 1e3, now) if self.picture else float("inf")
