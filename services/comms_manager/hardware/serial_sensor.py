"""Base class of sensors that stream over a dedicated serial port."""

import contextlib
import math
import select
import termios
import time
from abc import abstractmethod
from threading import Event, Lock

import serial

from valor.comms_manager.hardware.condition import DeviceClock
from valor.comms_manager.hardware.device import Device, DeviceContext, DeviceError, Fault, UnitFault, UnitRecord
from valor.devices.frame_stream import FrameStream
from valor.devices.ports import EmulatedLine, open_serial, serial_port

ANSWER_TIME = 0.1  # timeout of a command [s]
TRIES = 10  # of a command, at start
LATEST = 0.02  # largest delay of an accepted sample [s]
RETRY_PERIOD = 0.5  # period of searching for a disconnected sensor [s]
STREAM_LOST = 1.0  # timeout of samples, after which streaming is requested again [s]
_WAIT = 0.02  # time between reads that delays no sample [s]
_READ = 4096


class NoAnswerError(DeviceError):
    """The sensor does not respond to a command."""


class SerialSensor(Device):
    """A sensor on its own port: identified, set up to stream, read, and found again after a disconnection."""

    first_sample = 1.0  # timeout of the first sample at start [s]

    def __init__(self, name: str, context: DeviceContext, rate: float, baud_rate: int, stream: FrameStream) -> None:
        """``stream``: of the protocol's frames."""
        super().__init__(name, context)
        self._path = serial_port(context.instance, context.settings, name)
        self._baud_rate = baud_rate
        self._record = UnitRecord(name)
        self.records = (self._record,)
        self.rate = rate
        self._stream = stream
        self._port: serial.Serial | EmulatedLine | None = None
        self._using = Lock()  # held by who uses the port: main loop, or the thread that searches for the sensor
        self._clock = DeviceClock()
        self._unread = True  # samples wait that were received while other devices were found
        self._looked = math.inf  # time of the last read [monotonic s]
        self._away = 0.0  # delay of the latest read, above ``_WAIT`` [s]

    @abstractmethod
    def _wanted(self) -> str:
        """Human-readable description of the expected sensor."""

    @abstractmethod
    def _begin(self, tries: int) -> None:
        """Check the sensor's identity, and set it up to stream; ``tries`` per command.

        Raises DeviceError: another sensor, or an unexpected response; ``NoAnswerError``: no response.
        """

    @abstractmethod
    def _take(self, frame: bytes) -> bool:
        """Process a frame with a valid checksum; returns whether its content is valid."""

    @property
    @abstractmethod
    def _farewell(self) -> bytes:
        """Command that stops the stream."""

    @property
    def _is_known(self) -> bool:
        return self._record.states > 0

    def _frames(self, data: bytes) -> list[bytes]:
        """Frames completed by received bytes; counts invalid bytes and frames as errors."""
        stream = self._stream
        invalid, skipped = stream.invalid, stream.skipped
        frames = list(stream.feed(data))
        self._record.errors += (stream.invalid - invalid) or int(stream.skipped > skipped)
        return frames

    def _lateness(self, device_time: float, stamp: int) -> float | None:
        """Delay of a sample with a time stamp of the sensor [s], received at ``stamp`` [monotonic ns].

        None if it is too late to be used; time in which the port was not read is not counted.
        """
        late = self._clock.lateness(device_time, 1e-9 * stamp) if math.isfinite(device_time) else None
        return None if late is None or late > LATEST + self._away else late

    def find(self) -> None:
        self._connect(TRIES)
        deadline = time.monotonic() + self.first_sample
        while not self._is_known:
            if time.monotonic() > deadline:
                raise DeviceError(f"{self.name}: identity received, but no valid sample; expected {self._wanted()}")
            self._listen(ANSWER_TIME)

    def close(self) -> None:
        if self._port is not None:
            with contextlib.suppress(OSError):  # it is disconnected
                self._port.write(self._farewell)
            self._disconnect()

    def _connect(self, tries: int) -> None:
        try:
            self._port = open_serial(self._path, self._baud_rate, timeout=0.0)
        except OSError as error:
            raise DeviceError(
                f"{self.name}: {self._path} cannot be opened: {error}; expected {self._wanted()}"
            ) from None
        try:
            self._stream.clear()
            self._clock.reset()
            self._begin(tries)
        except (DeviceError, OSError):
            self._disconnect()
            raise

    def _disconnect(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    def gather(self) -> None:
        if not self._using.acquire(blocking=False):
            return  # it is searched for
        try:
            if self._unread:
                self._discard_received()
            if self._port is None:
                self.looks += 1
            else:
                self._listen(0.0)
        except OSError:  # also pyserial's
            self._lose()
        finally:
            self._using.release()

    def run(self, stopping: Event) -> None:
        """Find the sensor again after a disconnection, or when its samples stop."""
        while not stopping.wait(RETRY_PERIOD):
            if self._port is not None and time.monotonic() - 1e-9 * self._record.stamp <= STREAM_LOST:
                continue
            with self._using:
                self._disconnect()
                try:
                    self._connect(tries=1)
                    self.report_faults([])
                except OSError:
                    self._lose()
                except NoAnswerError:
                    pass  # its timeout is reported
                except DeviceError as error:
                    if self._path.exists():
                        text = str(error).removeprefix(f"{self.name}: ")
                        self.report_faults([UnitFault(self.name, Fault.FAULTY, text)])

    def _lose(self) -> None:
        self._disconnect()
        self.report_faults([UnitFault(self.name, Fault.UNPLUGGED, f"{self._path} is gone")])

    def _discard_received(self) -> None:
        """Discard samples that are too late."""
        self._unread = False
        with contextlib.suppress(OSError, termios.error):  # disconnected: detected by the next read
            if self._port is not None:
                self._port.reset_input_buffer()
        self._stream.clear()

    def _listen(self, timeout: float) -> None:
        for frame in self._frames(self._read(timeout)):
            if not self._take(frame):
                self._record.errors += 1
        self.looks += 1

    def _read(self, timeout: float) -> bytes:
        """The first bytes received within a time [s]."""
        assert self._port is not None
        if timeout:
            select.select((self._port.fileno(),), (), (), timeout)
        # A kernel worker of low priority delivers a terminal's bytes; on a busy computer ``select`` waits for it beyond
        # its own timeout.
        now = time.monotonic()
        self._away, self._looked = max(0.0, now - self._looked - _WAIT), now
        data: bytes = self._port.read(_READ)
        return data
