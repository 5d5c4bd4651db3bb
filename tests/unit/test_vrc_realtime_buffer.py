"""The two-slot buffer: newest wins, nothing is torn, ``None`` when there is nothing new."""

import itertools
import sys
import threading
from typing import Any

from valor.valor_ros_controller.realtime_buffer import RealTimeBuffer


def test_reads_each_value_once_and_the_newest_only() -> None:
    buffer: RealTimeBuffer[str] = RealTimeBuffer()
    assert buffer.read() is None and buffer.newest is None
    buffer.write("a")
    buffer.write("b")
    assert buffer.read() == "b"
    assert buffer.read() is None
    assert buffer.newest == "b"


def test_a_value_that_is_false_is_still_news() -> None:
    buffer: RealTimeBuffer[int] = RealTimeBuffer()
    buffer.write(0)
    assert buffer.read() == 0
    assert buffer.read() is None


def test_under_threads_values_are_whole_in_order_and_the_last_arrives() -> None:
    buffer: RealTimeBuffer[tuple[int, int]] = RealTimeBuffer()
    last, seen, torn = 200_000, list[Any](), list[Any]()
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)

    def write() -> None:
        for i in range(1, last + 1):
            buffer.write((i, -i))

    try:
        writer = threading.Thread(target=write)
        writer.start()
        while not seen or seen[-1] != last:
            finished = not writer.is_alive()
            if (value := buffer.read()) is not None:
                seen.append(value[0])
                if value[0] != -value[1]:
                    torn.append(value)
            elif finished:
                break
        writer.join()
    finally:
        sys.setswitchinterval(interval)
    assert not torn
    assert seen[-1] == last
    assert all(a < b for a, b in itertools.pairwise(seen)), "an old value came after a newer one"
