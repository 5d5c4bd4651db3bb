"""Sensors that stream over a serial port of their own, whatever they measure and however they say it."""

from __future__ import annotations

import contextlib
import math
import select
import termios
import time
from abc import abstractmethod
from pathlib import Path
from threading import Event

import serial

from valor.comms_manager.hardware.device import Ailment, Device, DeviceContext, DeviceError, Fault, UnitRecord
from valor.comms_manager.hardware.device_clock import DeviceClock
from valor.devices.ports import serial_port

ANSWER_TIME = 0.1  # of a command [s]
TRIES = 10  # of a command, at start
FIRST_SAMPLE = 1.0  # within which one must come, unless a protocol says otherwise [s]
LATEST = 0.02  # a sample that is held up longer is not used [s]
RETRY_PERIOD = 0.5  # between attempts to find a sensor that is gone [s]
STREAM_LOST = 1.0  # without a sample, after which it is asked to stream again [s]
_WAIT = 0.02  # longest sleep of the thread [s]
_READ = 4096


class NoAnswerError(DeviceError):
    """The sensor does not answer a command."""


class SerialSensor(Device):
    """A sensor alone on its port: asked who it is and to stream, listened to, and looked for when it is gone.

    Attributes:
        first_sample: within which what it provides must be known at start [s].
    """

    first_sample = FIRST_SAMPLE

    def __init__(self, name: str, context: DeviceContext, rate: float, baud_rate: int) -> None:
        super().__init__(name, context)
        self._path: Path = serial_port(context.instance, context.settings, name)
        self._baud_rate = baud_rate
        self._record = UnitRecord(name)
        self.records = (self._record,)
        self.rate = rate
        self._port: serial.Serial | None = None
        self._clock = DeviceClock()
        self._looked = math.inf  # at the port, last; before the first time, never [monotonic s]
        self._away = 0.0  # how long nobody had looked, beyond what the thread sleeps, before it did now [s]

    # --- what a protocol adds -----------------------------------------------------------------------------------------

    @abstractmethod
    def _wanted(self) -> str:
        """Which sensor is expected, for people."""

    @abstractmethod
    def _begin(self, tries: int) -> None:
        """See that it is the sensor of robot.yaml, and have it stream; so many tries a command.

        Raises:
            DeviceError: it is another one, or does not do as it must; ``NoAnswerError``: it says nothing.
        """

    @abstractmethod
    def _hear(self, data: bytes) -> None:
        """Take in what came over the port."""

    @abstractmethod
    def _forget(self) -> None:
        """Forget what is half received, and when samples came."""

    @property
    @abstractmethod
    def _farewell(self) -> bytes:
        """What has it be quiet."""

    @property
    def _is_known(self) -> bool:
        """Whether a sample has said what it provides."""
        return self._record.states > 0

    def _lateness(self, device_time: float, stamp: int) -> float | None:
        """How late a sample is of a time by the sensor's clock, that came at ``stamp`` [s, monotonic ns].

        None: it is not to be used. What lay here, unread, is not the sensor's to answer for.
        """
        late = self._clock.lateness(device_time, 1e-9 * stamp) if math.isfinite(device_time) else None
        return None if late is None or late > LATEST + self._away else late

    # --- start and end ------------------------------------------------------------------------------------------------

    def find(self) -> None:
        """Check who it is, have it stream, and get a first sample."""
        self._connect(TRIES)
        deadline = time.monotonic() + self.first_sample
        while not self._is_known:
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"{self.name}: it says who it is, but no sound sample came; expected {self._wanted()}"
                )
            self._listen(ANSWER_TIME)

    def close(self) -> None:
        """Have it be quiet, and close the port."""
        if self._port is not None:
            with contextlib.suppress(serial.SerialException, OSError):  # it is gone: it is quiet
                self._port.write(self._farewell)
            self._disconnect()
        super().close()

    def _connect(self, tries: int) -> None:
        try:
            self._port = serial.Serial(
                str(self._path), self._baud_rate, timeout=0, write_timeout=ANSWER_TIME, exclusive=True
            )
        except (serial.SerialException, OSError) as error:
            raise DeviceError(
                f"{self.name}: {self._path} cannot be opened: {error}; expected {self._wanted()}"
            ) from None
        try:
            self._forget()
            self._clock.reset()
            self._begin(tries)
        except (DeviceError, serial.SerialException, OSError):
            self._disconnect()
            raise

    def _disconnect(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    # --- the thread ---------------------------------------------------------------------------------------------------

    def run(self, stopping: Event) -> None:
        """Take samples in until told to stop; find the sensor again when it is gone."""
        looked = time.monotonic()
        self._throw_away()
        while not stopping.is_set():
            try:
                if self._port is not None:
                    self._listen(_WAIT)
                now = time.monotonic()
                lost = self._port is None or now - 1e-9 * self._record.stamp > STREAM_LOST
                if lost and now - looked > RETRY_PERIOD:
                    looked = now
                    self._disconnect()
                    self._connect(tries=1)
                    self.tell([])
                elif self._port is None:
                    stopping.wait(_WAIT)
                    self.looks += 1
            except (serial.SerialException, OSError):
                self._disconnect()
                self.tell([Ailment(self.name, Fault.UNPLUGGED, f"{self._path} is gone")])
            except NoAnswerError:
                continue  # it is silent, and told to be
            except DeviceError as error:
                if self._path.exists():
                    self.tell([Ailment(self.name, Fault.FAULTY, str(error).removeprefix(f"{self.name}: "))])

    def _throw_away(self) -> None:
        """Forget what came while other devices were found: seconds of samples, each too late to be used."""
        with contextlib.suppress(serial.SerialException, termios.error):  # it is gone: that is found out soon
            if self._port is not None:
                self._port.reset_input_buffer()
        self._forget()

    def _listen(self, timeout: float) -> None:
        self._hear(self._read(timeout))
        self.looks += 1

    def _read(self, timeout: float) -> bytes:
        """The first bytes that come within a time [s]."""
        assert self._port is not None
        ready, _, _ = select.select((self._port.fileno(), self.woken), (), (), timeout)
        # The kernel hands a terminal's bytes over by a worker of low priority, and ``select`` waits for that one beyond
        # its own time-out: on a busy computer for longer than this thread does for its turn.
        now = time.monotonic()
        self._away, self._looked = max(0.0, now - self._looked - _WAIT), now
        if self.woken in ready:
            self.drain_wake()
        if self._port.fileno() not in ready:
            return b""
        data: bytes = self._port.read(_READ)
        return data
