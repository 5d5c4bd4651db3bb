"""The law of a joint's drive, found of what its motor turns with.

A drive that is told a set-point p with gains k, d and an effort τ_ff turns its joint by

    τ = share·τ_ff + strength·(k·dead(p − q, b) + d·(ṗ − q̇)),

``dead`` being zero within ± b, the play's half width, and less by b beyond. For a given b this is linear in the others:
b is the one that leaves least.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from valor.common.arrays import FloatArray

WIDEST = 0.15  # half width that is looked for [rad]
STEPS = 61  # of the look
LEAST_PLAY = 0.0008  # half width that shows [rad]
BETTER = 0.95  # what remains with play, share of what remains without, that shows it
TELLS = 0.95  # what remains, share of all torque, from which the law tells nothing, and nominal numbers hold
LOADED = 0.5  # torque by which a gear is turned to one side of its play [N·m]
SEEN = 20  # moments at least in which it was


@dataclass(frozen=True)
class Servo:
    """A joint's drive.

    Attributes:
        share: of τ_ff, 0 to 1. strength: of the gains. half_play: b [rad]; None: did not show.
        residual: torque that is left unexplained, RMS [N·m].
    """

    share: float
    strength: float
    half_play: float | None
    residual: float


def identify(
    *,
    error: FloatArray,
    rate_error: FloatArray,
    feed_forward: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
    effort: FloatArray,
) -> Servo:
    """Find the law of one joint; (T,) each.

    Args:
        error: p − q [rad].
        rate_error: ṗ − q̇ [rad/s].
        feed_forward: τ_ff [N·m].
        stiffness: k [N·m/rad].
        damping: d [N·m·s/rad].
        effort: τ, measured [N·m].
    """

    def fit(half: float) -> tuple[tuple[float, float], float]:
        dead = error - np.clip(error, -half, half)
        servo = stiffness * dead + damping * rate_error
        found = _not_negative(feed_forward, servo, effort)
        return found, float(np.linalg.norm(effort - found[0] * feed_forward - found[1] * servo))

    widest = min(WIDEST, float(np.abs(error).max(initial=0.0)))
    looks = np.linspace(0.0, widest, STEPS)
    best = int(np.argmin([fit(half)[1] for half in looks]))
    around = (looks[max(best - 1, 0)], looks[min(best + 1, STEPS - 1)])
    half = float(minimize_scalar(lambda b: fit(b)[1], bounds=around, method="bounded", options={"xatol": 1e-5}).x)
    shows = half >= LEAST_PLAY and fit(half)[1] < BETTER * fit(0.0)[1]
    half = half if shows else 0.0
    (taken, strength), left = fit(half)
    turned = int((np.abs(strength * stiffness * (error - np.clip(error, -half, half))) > LOADED).sum())
    residual = left / np.sqrt(error.size)
    if left > TELLS * float(np.linalg.norm(effort)):  # torques no larger than what sensors are off by
        return Servo(1.0, 1.0, None, float(residual))
    share = min(taken / strength, 1.0) if strength > 0.0 else 1.0
    return Servo(float(share), float(strength), half if shows and turned >= SEEN else None, float(residual))


def _not_negative(one: FloatArray, other: FloatArray, wanted: FloatArray) -> tuple[float, float]:
    """Least squares of two columns (T,), neither's share below zero."""
    a, b, c = float(one @ one), float(one @ other), float(other @ other)
    x, y = float(one @ wanted), float(other @ wanted)
    if (scale := a * c - b * b) > 1e-9 * a * c:
        first, second = (c * x - b * y) / scale, (a * y - b * x) / scale
        if first >= 0.0 and second >= 0.0:
            return first, second
    alone = (max(x / a, 0.0) if a else 0.0, 0.0), (0.0, max(y / c, 0.0) if c else 0.0)
    return max(alone, key=lambda shares: shares[0] * x + shares[1] * y)  # what explains more
