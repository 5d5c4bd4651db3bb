"""How late a device's words are, told by the device's own clock."""

from __future__ import annotations

import math

DRIFT = 2e-4  # of a device's clock against ours, at most [s/s]


class DeviceClock:
    """Compares a device's times with ours: the quickest word so far is taken not to have been late.

    Serial protocols have no sequence numbers; a device's own time stamps tell what was sent twice and what was held up.
    """

    def __init__(self) -> None:
        self._offset = math.inf  # ours less the device's, when nothing was held up [s]
        self._device = self._ours = -math.inf

    def lateness(self, device: float, ours: float) -> float | None:
        """How late a word is that the device dates ``device`` and that came at ``ours`` [s].

        None if it is not newer than the last.
        """
        if device <= self._device:
            return None
        if math.isfinite(self._ours):
            self._offset += DRIFT * (ours - self._ours)
        self._offset = min(self._offset, ours - device)
        self._device, self._ours = device, ours
        return ours - device - self._offset

    def reset(self) -> None:
        """Forget: the device has started anew."""
        self.__init__()  # type: ignore[misc]
