"""How many bytes may be sent now, and what the bytes went for."""

from __future__ import annotations

from collections import Counter, deque

from valor.link.classes import HEADERS, Rates


class Budget:
    """A bucket of bytes that fills evenly. It may be overdrawn once; the debt is paid before anything else is sent."""

    def __init__(self, rates: Rates, now: float) -> None:
        self._rates, self._bytes, self._at = rates, rates.burst, now

    def left(self, now: float) -> float:
        """[B]; negative: a debt."""
        self._bytes = min(self._rates.burst, self._bytes + self._rates.budget * (now - self._at))
        self._at = now
        return self._bytes

    def spend(self, size: int, now: float) -> None:
        """A datagram of so many bytes of content was sent; headers are added."""
        self._bytes = self.left(now) - size - HEADERS


class Meter:
    """Bytes by class over the last while, headers included.

    Attributes:
        total: since the beginning, by class.
    """

    WINDOW = 5.0  # [s]

    def __init__(self) -> None:
        self.total: Counter[str] = Counter()
        self._recent: deque[tuple[float, str, int]] = deque()

    def count(self, shares: dict[str, int], now: float) -> None:
        """One datagram."""
        for name, size in shares.items():
            self.total[name] += size
            self._recent.append((now, name, size))

    def rates(self, now: float) -> dict[str, float]:
        """By class [B/s]."""
        while self._recent and self._recent[0][0] < now - self.WINDOW:
            self._recent.popleft()
        sums: Counter[str] = Counter()
        for _, name, size in self._recent:
            sums[name] += size
        return {name: size / self.WINDOW for name, size in sums.items()}
