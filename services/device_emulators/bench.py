"""What the test bench does to the devices when asked: faults."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence

import bifrost
from valor.common.messages import FaultReply, FaultRequest
from valor.common.topics import FAULT
from valor.device_emulators.emulator import EmulatedFault, Emulator, NoSuchFaultError

LONGEST = 3600.0  # [s]
_log = logging.getLogger("device_emulators")


class FaultServer:
    """Answers ``simulation/fault``: lets a unit fail for a while, or for good, or ends all faults of a device."""

    def __init__(self, node: bifrost.Node, emulators: Sequence[Emulator]) -> None:
        self._emulators = {emulator.name: emulator for emulator in emulators}
        self._server = FAULT.server(node, self._inject)
        self._now = 0.0

    def serve(self, now: float) -> None:
        """Answer what waits, at a time of the emulators' clock [s]."""
        self._now = now
        self._server.serve()

    def _inject(self, request: FaultRequest, origin: str) -> FaultReply:
        reason = self._obey(request)
        if not reason:
            what = request.fault or "no fault"
            _log.info("%s wants %s of %s/%s for %g s", origin, what, request.device, request.unit, request.duration)
        return FaultReply(accepted=not reason, reason=reason)

    def _obey(self, request: FaultRequest) -> str:
        """Inject; returns why not, empty if done."""
        emulator = self._emulators.get(request.device)
        if emulator is None:
            return f"device {request.device!r}: expected one of {', '.join(self._emulators)}"
        if not request.fault:
            emulator.faults.clear()
            return ""
        if not 0.0 <= request.duration <= LONGEST:  # NaN is refused too
            return f"duration: {request.duration:g} s, expected up to {LONGEST:g}, or 0 for good"
        try:
            fault = EmulatedFault(request.fault)
        except ValueError:
            return f"fault {request.fault!r}: expected one of {', '.join(sorted(EmulatedFault))}, or nothing to end all"
        until = self._now + request.duration if request.duration else math.inf
        try:
            emulator.faults.inject(request.unit, fault, until)
        except NoSuchFaultError as error:
            return str(error)
        return ""
