"""``/link/status``: how old everything is that is shown, and what the link carries."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from valor.common.instance import Link
from valor.link.ends import OperatorEnd
from valor.link.fields import Layout

OLD = 1.0  # of the state: from then on it is a warning [s]


def status(end: OperatorEnd, layout: Layout, link: Link, now: float, fates: Mapping[str, str]) -> DiagnosticStatus:
    """As of now; ages are upper bounds [s].

    Args:
        end: the operator's.
        layout: of the state.
        link: what the robot does when its operator is not heard.
        now: monotonic [s].
        fates: what became of commands, as ``Fates.lines`` tells it.
    """
    state = end.state
    message = DiagnosticStatus(name="link")
    if state is None or not end.session.established:
        message.level = DiagnosticStatus.ERROR
        message.message = end.session.strange or "the robot has not been heard"
        message.values = [KeyValue(key=key, value=value) for key, value in fates.items()]
        return message
    age = end.age(now)
    silent = end.silent(now)
    message.level = DiagnosticStatus.WARN if age > OLD else DiagnosticStatus.OK
    message.message = f"the robot is silent for {silent:.1f} s" if silent > OLD else "the robot is heard"
    clamped = [name for name, place in layout.places.items() if state.clamped[place].any()]
    values = {
        "state_age": f"{age:.3f}", "stamp": f"{1e-3 * state.stamp:.3f}",
        "mode": state.mode, "mode_age": f"{state.mode_age + age:.3f}",
        "behavior": state.behavior, "behavior_age": f"{state.behavior_age + age:.3f}",
        "velocity_age": f"{state.velocity_age + age:.3f}",
        "step": str(state.step), "beyond_range": " ".join(clamped), "fast_channel": str(end.fast(now)).lower(),
        **fates, "states": str(end.states),
        "when_lost": link.when_lost, "lost_after": f"{link.lost_after:g}",
        **{f"sent.{name}": f"{rate:.0f} B/s" for name, rate in sorted(end.meter.rates(now).items())},
        **{f"heard.{name}": f"{rate:.0f} B/s" for name, rate in sorted(end.heard_meter.rates(now).items())},
    }  # fmt: skip
    message.values = [KeyValue(key=key, value=value) for key, value in values.items()]
    return message
