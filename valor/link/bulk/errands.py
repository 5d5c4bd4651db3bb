"""The bags that the operator wants, and what became of each; what is wanted outlives the process."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from valor.common import whole_file
from valor.link.bulk.wire import Described, checked_name
from valor.link.errors import BulkError, SealError

MOST = 64  # that may be wanted, and as many that have ended are remembered
_FILE = ".wanted.json"
ASKED = "waits for a window"


@dataclass
class Errand:
    """One bag.

    Attributes:
        said: how it stands, in words: ``waits …``, ``comes``, ``checking``, ``here``, ``failed: …``.
        here: [B].
        size: [B]; −1: not known yet.
        described: as the robot's end has it; None: it has not told.
        tries: that came to an end with the wrong bytes.
    """

    said: str = ASKED
    here: int = 0
    size: int = -1
    described: Described | None = None
    tries: int = 0
    ended: bool = False


class Errands:
    """In the order in which they were asked for.

    Attributes:
        all: by name, ended or not.
    """

    def __init__(self, folder: Path) -> None:
        self._file = folder / _FILE
        self.all: dict[str, Errand] = {}
        with contextlib.suppress(OSError, msgspec.MsgspecError):
            for name in msgspec.json.decode(self._file.read_bytes(), type=list[str])[:MOST]:
                with contextlib.suppress(SealError):
                    self.all[checked_name(name)] = Errand()

    def want(self, name: str) -> None:
        """Have a bag fetched; one that has failed, or is here, anew.

        Raises:
            SealError: no bag has that name.
            BulkError: too many are wanted, or it cannot be noted.
        """
        known = self.all.get(checked_name(name))
        if known is not None and not known.ended:
            return
        if len(self._waiting()) >= MOST:
            raise BulkError(f"{name}: {MOST} bags are wanted already; expected fewer")
        self.all.pop(name, None)
        self.all[name] = Errand()
        self._save()

    def wants(self, name: str) -> bool:
        """Whether it is to be fetched."""
        each = self.all.get(name)
        return each is not None and not each.ended

    def _waiting(self) -> list[str]:
        return [name for name, each in self.all.items() if not each.ended]

    def _save(self) -> None:
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            whole_file.write(self._file, msgspec.json.encode(self._waiting()))
        except OSError as error:
            raise BulkError(f"{self._file}: {error.strerror}") from None

    def unknown(self) -> str:
        """The first that the robot's end is to be asked about; empty: none."""
        return next((name for name, each in self.all.items() if not each.ended and each.described is None), "")

    def describe(self, described: Described) -> None:
        """The robot's end has it; a name that was not asked for is not taken."""
        each = self.all.get(checked_name(described.name))
        if each is not None and not each.ended:
            each.described, each.size = described, described.size

    def undescribe(self, name: str) -> None:
        """The robot's end is to be asked again."""
        if (each := self.all.get(name)) is not None:
            each.described = None

    def forget(self) -> None:
        """As ``undescribe``, of all."""
        for each in self.all.values():
            each.described = None

    def next(self, busy: Callable[[Described], bool]) -> Described | None:
        """The first that can be fetched, and is not ``busy``; None: there is none."""
        for each in self.all.values():
            if not each.ended and each.described is not None and not busy(each.described):
                return each.described
        return None

    def tell(self, name: str, said: str) -> None:
        """How it stands."""
        if (each := self.all.get(name)) is not None and not each.ended:
            each.said = said

    def progress(self, name: str, here: int, size: int) -> None:
        """It comes."""
        if (each := self.all.get(name)) is not None and not each.ended:
            each.said, each.here, each.size = "comes", here, size

    def again(self, name: str) -> int:
        """It came, but not as it should; returns how often so far."""
        each = self.all.setdefault(name, Errand())
        each.said, each.described, each.here = ASKED, None, 0
        each.tries += 1
        return each.tries

    def end(self, name: str, said: str) -> None:
        """It is here, or will not be."""
        each = self.all.get(name)
        if each is None or each.ended:
            return
        each.said, each.ended = said, True
        if said == "here":
            each.here = each.size
        for old in [other for other, one in self.all.items() if one.ended][:-MOST]:
            del self.all[old]
        with contextlib.suppress(BulkError):  # then it is fetched once more after a restart
            self._save()
