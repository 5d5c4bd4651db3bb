"""The two-slot buffer: newest wins, nothing is torn, ``None`` when there is nothing new."""

import itertools
import sys
from collections import deque
from concurrent.futures import ThreadPoolExecutor

from valor.valor_ros_controller.realtime_buffer import RealTimeBuffer


def test_reads_each_value_once_and_the_newest_only() -> None:
    buffer: RealTimeBuffer[str] = RealTimeBuffer()
    assert buffer.read() is None
    buffer.write("a")
    buffer.write("b")
    assert buffer.read() == "b"
    assert buffer.read() is None
    buffer.write("")
    assert buffer.read() == "", "a value that is false is still news"


def test_under_threads_values_are_whole_in_order_and_the_last_arrives() -> None:
    buffer: RealTimeBuffer[tuple[int, int]] = RealTimeBuffer()
    last, seen = 200_000, [(0, 0)]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(1) as pool:
            writer = pool.submit(lambda: deque(map(buffer.write, ((i, -i) for i in range(1, last + 1))), maxlen=0))
            while not writer.done():
                seen += filter(None, [buffer.read()])
            seen += filter(None, [buffer.read()])
    finally:
        sys.setswitchinterval(interval)
    assert all(value == -other for value, other in seen)
    assert seen[-1][0] == last
    assert all(a < b for a, b in itertools.pairwise(seen)), "an old value came after a newer one"
