"""The course of uneven dirt, as the DARPA Robotics Challenge Finals had one: bumps under every foot, and slopes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.simulation.worlds.world import DIRT, MARK, decoration, floor, ground

_BEFORE, _BEYOND = 2.0, 5.0  # ground behind the start and beyond the finish [m]
_PAD = (0.6, 1.6)  # level up to the first x, the full course from the second on [m]
_FIRST_PATCH, _LAST_PATCH = 4.0, 3.0  # from the start, and before the finish [m]
_RAMP, _SHELF = 3.0, 1.5  # lengths of a patch that rises or falls, and of the level between the two [m]
_TILT, _FADE = 3.0, 3.4  # lengths of a patch that leans sideways, and of the way into it and out of it [m]
_LEANING = 1.5  # distance from the middle up to which it leans [m]
_ROUNDING = 0.4  # of the kinks in a ramp [m]
_DEVIATION = 0.45  # of the bumps, of their bound: so that they fill what they are allowed
_BASE = 0.05  # thickness of the ground below its lowest point [m]


@dataclass(frozen=True)
class Dirt:
    """A height field from a level pad to beyond a finish line: patches of slope, and bumps all over.

    The patches – ramps up and down, and ground that leans to a side – come in an order that the seed decides. Their
    slope is never steeper than ``slope`` by itself. The bumps add heights between ``-bump_height`` and
    ``bump_height`` of all lengths between the two of ``bump_lengths``, each octave with as much of them.
    """

    course: float  # from the start to the finish line [m]
    bump_height: float  # [m]
    bump_lengths: tuple[float, float]  # shortest and longest [m]
    slope: float  # of the patches [degrees]
    width: float = 8.0  # [m]
    resolution: float = 0.05  # of the height field [m]

    @property
    def x(self) -> FloatArray:
        """(nx,) of the height field's points [m]."""
        return np.arange(-_BEFORE, self.course + _BEYOND + self.resolution / 2, self.resolution)

    @property
    def y(self) -> FloatArray:
        """(ny,) [m]."""
        return np.arange(-self.width / 2, self.width / 2 + self.resolution / 2, self.resolution)

    def sized(self, size: float) -> Self:
        """Bumps so many times as high."""
        return replace(self, bump_height=size * self.bump_height)

    def add_to(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
        """Add the height field, and marks along it."""
        x, y = self.x, self.y
        height = self.slopes(rng) + self.bumps(rng)
        low, high = float(height.min()), float(height.max())
        spec.add_hfield(
            name="course",
            nrow=y.size,
            ncol=x.size,
            size=[(x[-1] - x[0]) / 2, (y[-1] - y[0]) / 2, high - low, _BASE],
            userdata=((height - low) / (high - low)).ravel(),
        )
        ground(
            spec,
            name="course",
            type=mujoco.mjtGeom.mjGEOM_HFIELD,
            hfieldname="course",
            pos=[(x[0] + x[-1]) / 2, 0, low],
            material=DIRT,
        )
        floor(spec, low - _BASE)
        self._mark(spec, height)

    def slopes(self, rng: np.random.Generator) -> FloatArray:
        """(ny, nx) heights of the ground without its bumps [m]."""
        x, y = self.x, self.y
        steepest = math.tan(math.radians(self.slope))
        along, leaning = np.zeros(x.size), np.zeros(x.size)
        kinds = rng.permutation(["hill", "hollow", "left", "right"])
        lengths = [2 * _RAMP + _SHELF if kind in ("hill", "hollow") else 2 * _FADE + _TILT for kind in kinds]
        room = self.course - _LAST_PATCH - _FIRST_PATCH - sum(lengths)
        gaps = rng.dirichlet(np.full(len(kinds), 4.0)) * room
        at = _FIRST_PATCH
        for kind, length, gap in zip(kinds, lengths, gaps, strict=True):
            at += gap
            sign = 1.0 if kind in ("hill", "left") else -1.0
            if kind in ("hill", "hollow"):
                corners = [at, at + _RAMP, at + _RAMP + _SHELF, at + length]
                along += np.interp(x, corners, [0.0, sign * steepest * _RAMP, sign * steepest * _RAMP, 0.0])
            else:
                inside = _smooth((x - at) / _FADE) * _smooth((at + length - x) / _FADE)
                leaning += sign * steepest * inside
            at += length
        window = max(1, round(_ROUNDING / self.resolution))
        along = np.convolve(np.pad(along, window, mode="edge"), np.full(window, 1.0 / window), "same")[window:-window]
        return along[None, :] - leaning[None, :] * np.clip(y, -_LEANING, _LEANING)[:, None]

    def bumps(self, rng: np.random.Generator) -> FloatArray:
        """(ny, nx) heights to add to the slopes [m]; none at the start."""
        x, y = self.x, self.y
        shortest, longest = self.bump_lengths
        frequency = np.hypot(
            np.fft.fftfreq(y.size, self.resolution)[:, None], np.fft.rfftfreq(x.size, self.resolution)[None, :]
        )
        inside = (frequency >= 1.0 / longest) & (frequency <= 1.0 / shortest)
        # In the plane, power as 1/f² gives each octave the same share.
        amplitude = np.where(inside, 1.0 / np.maximum(frequency, 1.0 / longest), 0.0)
        noise = np.fft.rfft2(rng.standard_normal((y.size, x.size)))
        height = np.fft.irfft2(noise * amplitude, (y.size, x.size))
        height *= _DEVIATION / height.std()
        height = self.bump_height * np.tanh(height)
        return height * _smooth((np.abs(x) - _PAD[0]) / (_PAD[1] - _PAD[0]))[None, :]

    def _mark(self, spec: mujoco.MjSpec, height: FloatArray) -> None:
        """Posts every ten metres on both sides, and a gate at the finish line."""
        box, cylinder = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER
        for x in (*np.arange(10.0, self.course - 5.0, 10.0), self.course):
            finish = x == self.course
            tall = 2.2 if finish else 0.4
            for y in (-2.0, 2.0):
                foot = self._height_at(height, float(x), y)
                decoration(
                    spec, type=cylinder, pos=[x, y, foot + tall / 2], size=[0.03, tall / 2 + 0.05, 0], material=MARK
                )
            if finish:
                top = self._height_at(height, float(x), 0.0) + tall
                decoration(spec, type=box, pos=[x, 0, top], size=[0.02, 2.0, 0.15], material=MARK)

    def _height_at(self, height: FloatArray, x: float, y: float) -> float:
        column = round((x + _BEFORE) / self.resolution)
        return float(height[round((y + self.width / 2) / self.resolution), column])


def _smooth(share: FloatArray) -> FloatArray:
    """From 0 to 1 without a kink (3s² − 2s³)."""
    s = np.clip(share, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)
