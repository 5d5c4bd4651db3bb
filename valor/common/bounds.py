"""How much of an instance's recordings stays: bounds of age, of size, of the disk."""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Meta

from valor.common.table import Positive, Table

DAY = 86400.0  # [s]
# A piece that is being written cannot go, so it is at most this part of what recordings may take.
PIECES = 8
LEAST_PIECE = 1 << 20  # [B]


class Bounds(Table):
    """How much of an instance's recordings stays; None: no bound of that kind.

    The defaults: a month, some five hours of everything that there is, and never more than a tenth of a small disk.
    """

    age: Positive | None = 30 * DAY  # since a piece was finished [s]
    size: Annotated[int, Meta(ge=8 * LEAST_PIECE, extra={"unit": "B"})] | None = 20_000_000_000  # of all together [B]
    share: Annotated[float, Meta(gt=0, le=1)] | None = 0.1  # of the disk that they are on, all together

    def limit(self, capacity: int) -> int | None:
        """What all together may take on a disk of that capacity [B]; None: as much as there is."""
        limits = [self.size, None if self.share is None else round(self.share * capacity)]
        return min((each for each in limits if each is not None), default=None)

    def piece(self, capacity: int) -> tuple[float, float]:
        """What a single piece may take, so that the one that is being written fits in [B], and how long [s]."""
        limit = self.limit(capacity)
        return (
            math.inf if limit is None else max(LEAST_PIECE, limit // PIECES),
            math.inf if self.age is None else self.age / PIECES,
        )


UNBOUNDED = Bounds(age=None, size=None, share=None)
