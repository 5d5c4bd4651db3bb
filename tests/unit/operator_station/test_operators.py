"""Who may command, and what of it is new enough to be obeyed."""

import pytest

from valor.common.errors import RefusalError
from valor.operator_station.ages import Ages
from valor.operator_station.commands import CommandLog
from valor.operator_station.heartbeat import COMMAND, Heartbeat
from valor.operator_station.lease import Lease
from valor.operator_station.pad import FASTEST, HELD, STILL, Pad
from valor.operator_station.timeline import Timeline

TOKEN = "seven"


def test_only_who_shows_the_token_operates() -> None:
    lease = Lease(TOKEN)
    with pytest.raises(RefusalError, match=r"operator\.token"):
        lease.claim(1, "Ann", "eight")
    with pytest.raises(RefusalError, match="nobody operates"):
        lease.require(1)
    lease.claim(1, "Ann", f" {TOKEN}\n")
    assert lease.require(1) == "Ann"
    with pytest.raises(RefusalError, match="Ann operates"):
        lease.require(2)


def test_without_a_token_nobody_operates() -> None:
    with pytest.raises(RefusalError):
        Lease("").claim(1, "Ann", "")


def test_a_second_operator_asks_or_takes_over() -> None:
    lease = Lease(TOKEN)
    lease.claim(1, "Ann", TOKEN)
    with pytest.raises(RefusalError, match="told that Bob asks"):
        lease.claim(2, "Bob", TOKEN)
    assert lease.holds(1)
    assert lease.describe() == "Ann operates; Bob asks for control"
    lease.claim(2, "Bob", TOKEN, over=True)
    assert lease.holds(2)
    assert not lease.holds(1)
    assert lease.describe() == "Bob operates"
    assert not lease.release(1)
    assert lease.release(2)


def test_a_reloaded_page_goes_on_and_nobody_elses_does() -> None:
    lease = Lease(TOKEN)
    secret = lease.claim(1, "Ann", TOKEN)
    assert not lease.resume(2, secret), "the operator is still there"
    assert lease.left(1)
    assert not lease.left(1)
    assert "gone" in lease.describe()
    assert not lease.resume(3, "another")
    assert lease.resume(4, secret)
    assert lease.require(4) == "Ann"


def test_who_is_gone_is_followed_without_asking() -> None:
    lease = Lease(TOKEN)
    secret = lease.claim(1, "Ann", TOKEN)
    lease.left(1)
    lease.claim(2, "Bob", TOKEN)
    assert lease.holds(2)
    assert not lease.resume(3, secret)


def test_what_waited_in_a_cut_connection_is_found_out() -> None:
    """A click that was made in the cut comes with the answer to the last question before it, however quick that is."""
    beat = Heartbeat(10.0)
    beat.answered(10.1)
    assert beat.bound(10.2) == pytest.approx(0.1)
    # The cut: the question of 10.2 is answered at 15.2 only, and a click comes with the answer.
    beat.answered(10.2)
    log = CommandLog()
    with pytest.raises(RefusalError, match=r"came too late: made up to 5\.0 s ago"):
        log.begin("step", "Ann", beat.bound(15.2), 15.2, COMMAND)
    assert log.commands[0].state == "refused"
    beat.answered(15.21)
    again = log.begin("step", "Ann", beat.bound(15.3), 15.3, COMMAND)
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


def test_every_value_knows_how_old_it_is() -> None:
    ages = Ages()
    assert ages.old("joints", 1.0)
    assert ages.text("joints", 1.0) == "never heard"
    ages.heard("joints", 1.0)
    assert not ages.old("joints", 1.5)
    assert ages.old("joints", 1.6)
    assert ages.text("joints", 1.6) == "0.6 s old"
    assert ages.text("joints", 1.2) == "fresh"


def test_the_timeline_has_bands_of_what_was() -> None:
    modes = Timeline()
    assert modes.bands(0.0, 9.0) == []
    assert modes.note(1.0, "stand")
    assert not modes.note(2.0, "stand")
    modes.note(4.0, "walk")
    assert modes.bands(0.0, 6.0) == [(1.0, 4.0, "stand"), (4.0, 6.0, "walk")]
    assert modes.bands(4.5, 6.0) == [(4.5, 6.0, "walk")]
    modes.note(6.0, "<b>")
    assert "&lt;b&gt;" in modes.markup(0.0, 9.0)
    assert "<b>" not in modes.markup(0.0, 9.0)
