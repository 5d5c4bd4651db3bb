"""Who may command, and what of it is new enough to be obeyed."""

import pytest

from valor.common.errors import RefusalError
from valor.operator_station.commands.log import CommandLog
from valor.operator_station.commands.queue import COMMAND, Heartbeat, Lease
from valor.operator_station.tabs.drive import FASTEST, HELD, STILL, Pad

TOKEN = "seven"


def test_only_who_shows_the_token_operates() -> None:
    lease = Lease(TOKEN)
    with pytest.raises(RefusalError, match=r"operator\.token"):
        lease.claim(1, "Ann", "eight")
    with pytest.raises(RefusalError, match="nobody operates"):
        lease.require(1)
    with pytest.raises(RefusalError):
        Lease("").claim(1, "Ann", "")
    lease.claim(1, "Ann", f" {TOKEN}\n")
    assert lease.require(1) == "Ann"
    with pytest.raises(RefusalError, match="Ann operates"):
        lease.require(2)


def test_a_second_operator_asks_or_takes_over() -> None:
    lease = Lease(TOKEN)
    lease.claim(1, "Ann", TOKEN)
    with pytest.raises(RefusalError, match="told that Bob asks"):
        lease.claim(2, "Bob", TOKEN)
    assert lease.holds(1) and lease.describe() == "Ann operates; Bob asks for control"
    lease.claim(2, "Bob", TOKEN, over=True)
    assert lease.holds(2) and not lease.holds(1) and lease.describe() == "Bob operates"
    assert not lease.release(1) and lease.release(2)


def test_a_reloaded_page_continues_and_no_one_elses_does() -> None:
    lease = Lease(TOKEN)
    secret = lease.claim(1, "Ann", TOKEN)
    assert not lease.resume(2, secret), "the operator is still there"
    assert lease.left(1) and not lease.left(1)
    assert "gone" in lease.describe()
    assert not lease.resume(3, "another")
    assert lease.resume(4, secret) and lease.require(4) == "Ann"
    lease.left(4)
    lease.claim(5, "Bob", TOKEN)
    assert lease.holds(5), "an operator who has left is followed without a request"
    assert not lease.resume(6, secret)


def test_what_waited_in_a_cut_connection_is_found_out() -> None:
    """A click that was made in the cut comes with the answer to the last question before it, however quick that is."""
    beat = Heartbeat(10.0)
    beat.answered(10.1)
    assert beat.bound(10.2) == pytest.approx(0.1)
    # The cut: the question of 10.2 is answered at 15.2 only, and a click comes with the answer.
    beat.answered(10.2)
    log = CommandLog()
    with pytest.raises(RefusalError, match=r"came too late: made up to 5\.0 s ago"):
        log.begin("step", "Ann", beat.bound(15.2), COMMAND)
    assert log.commands[0].state == "refused"
    beat.answered(15.21)
    again = log.begin("step", "Ann", beat.bound(15.3), COMMAND)
    assert (again.sequence, again.state) == (2, "sent")
    beat.answered(9.0)
    assert beat.bound(15.3) == pytest.approx(0.09), "an older answer tells nothing"


def test_the_pad_moves_only_while_it_is_held() -> None:
    pad = Pad(speed=0.5)
    assert pad.velocity(0.0) is None
    assert pad.hold("forward", 1.0), "the press itself"
    assert not pad.hold("forward", 1.1)
    assert pad.velocity(1.2) == (0.5 * FASTEST[0], 0.0, 0.0)
    assert pad.velocity(1.1 + HELD) == STILL
    assert pad.velocity(1.2 + HELD) is None, "said once"
    pad.hold("turn right", 2.0)
    assert pad.velocity(2.0) == (0.0, 0.0, -0.5 * FASTEST[2])
    pad.release()
    assert pad.velocity(2.0) == STILL
    assert pad.hold("turn right", 2.1)
