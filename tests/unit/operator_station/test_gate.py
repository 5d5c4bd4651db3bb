"""Messages go to viser from threads beside its event loop."""

import asyncio

from viser._messages import GuiCloseModalMessage
from viser.infra._async_message_buffer import AsyncMessageBuffer

import valor.operator_station.gate  # noqa: F401  # mends viser


def test_a_message_is_sent_although_the_event_loop_changes_who_waits_for_it_meanwhile() -> None:
    loop = asyncio.new_event_loop()
    buffer = AsyncMessageBuffer(loop, persistent_messages=True)
    waiters = buffer.message_event._waiters

    class Arriving(asyncio.Future[bool]):
        """Waits, and another one begins to wait as soon as it is asked."""

        def done(self) -> bool:
            if len(waiters) == 1:
                waiters.append(loop.create_future())
            return super().done()

    waiters.append(Arriving(loop=loop))
    buffer.push(GuiCloseModalMessage("1"))
    assert buffer.message_counter == 1
    assert loop.run_until_complete(asyncio.wait_for(buffer.message_event.wait(), 10.0))
    assert all(each.done() for each in waiters)
    loop.close()
