"""Ground to walk on: uneven dirt, as at the DARPA Robotics Challenge Finals, rubble, and stairs."""

import math
from dataclasses import dataclass, replace
from typing import Self

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.simulation.worlds.world import DIRT, EDGE, MARK, STONE, World, block, decoration, floor, ground

_BEFORE, _BEYOND = 2.0, 5.0  # ground behind the start and after the finish [m]
_PAD = (0.6, 1.6)  # distances from the start: level, full height [m]
_FIRST_PATCH, _LAST_PATCH = 4.0, 3.0  # distances from start and finish [m]
_RAMP, _SHELF = 3.0, 1.5  # lengths of a ramp, and of the level part between two [m]
_TILT, _FADE = 3.0, 3.4  # lengths of a patch with a lateral slope, and of the transitions [m]
_LEANING = 1.5  # half width of a lateral slope [m]
_ROUNDING = 0.4  # of the edges of a ramp [m]
_DEVIATION = 0.45  # standard deviation of the bumps, as a fraction of their bound
_BASE = 0.05  # thickness of the ground below its lowest point [m]


@dataclass(frozen=True)
class Dirt(World):
    """A height field from a level pad past a finish line: patches of slope, and bumps everywhere.

    The patches (ramps up and down, lateral slopes) are in random order, up to ``slope`` steep. The bumps have heights
    within ±``bump_height`` and all lengths between the two of ``bump_lengths``, with equal power in each octave.
    """

    course: float  # from the start to the finish line [m]
    bump_height: float  # [m]
    bump_lengths: tuple[float, float]  # shortest and longest [m]
    slope: float  # of the patches [degrees]
    width: float = 8.0  # [m]
    resolution: float = 0.05  # of the height field [m]

    @property
    def x(self) -> FloatArray:
        """(nx,) of the grid [m]."""
        return np.arange(-_BEFORE, self.course + _BEYOND + self.resolution / 2, self.resolution)

    @property
    def y(self) -> FloatArray:
        """(ny,) of the grid [m]."""
        return np.arange(-self.width / 2, self.width / 2 + self.resolution / 2, self.resolution)

    def sized(self, size: float) -> Self:
        """Scale the height of the bumps."""
        return replace(self, bump_height=size * self.bump_height)

    def add_to(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
        """Add the height field and its marks."""
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
        """(ny, nx) heights without the bumps [m]."""
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
        """(ny, nx) heights in addition to the slopes [m]; 0 at the start."""
        x, y = self.x, self.y
        shortest, longest = self.bump_lengths
        frequency = np.hypot(
            np.fft.fftfreq(y.size, self.resolution)[:, None], np.fft.rfftfreq(x.size, self.resolution)[None, :]
        )
        inside = (frequency >= 1.0 / longest) & (frequency <= 1.0 / shortest)
        # In two dimensions, power as 1/f² is equal in each octave.
        amplitude = np.where(inside, 1.0 / np.maximum(frequency, 1.0 / longest), 0.0)
        noise = np.fft.rfft2(rng.standard_normal((y.size, x.size)))
        height = np.fft.irfft2(noise * amplitude, (y.size, x.size))
        height *= _DEVIATION / height.std()
        height = self.bump_height * np.tanh(height)
        return height * _smooth((np.abs(x) - _PAD[0]) / (_PAD[1] - _PAD[0]))[None, :]

    def _mark(self, spec: mujoco.MjSpec, height: FloatArray) -> None:
        """Add posts every ten metres on both sides, and a gate at the finish line."""
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


def _smooth(fraction: FloatArray) -> FloatArray:
    """Smooth step from 0 to 1 (3s² − 2s³)."""
    s = np.clip(fraction, 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


_TONES = (0.52, 0.70)  # range of grey of the boxes


@dataclass(frozen=True)
class Rubble(World):
    """Field of boxes, on average one per ``spacing``, with random heights and orientations; they may overlap."""

    highest: float  # of a box [m]
    start: float  # x at which the patch begins [m]
    length: float  # of the patch [m]
    width: float = 2.4  # [m]
    spacing: float = 0.2  # of the boxes' middles, before they are moved [m]
    sides: tuple[float, float] = (0.12, 0.30)  # shortest and longest [m]

    def sized(self, size: float) -> Self:
        """Scale the height of the boxes."""
        return replace(self, highest=size * self.highest)

    def add_to(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
        """Add floor and boxes."""
        floor(spec)
        reach = self.sides[1] / math.sqrt(2.0)  # of a corner
        xs = np.arange(self.start + reach, self.start + self.length - reach / 2, self.spacing)
        ys = np.arange(-self.width / 2 + reach, self.width / 2 - reach / 2, self.spacing)
        for x in xs:
            for y in ys:
                shift = rng.uniform(-0.25, 0.25, 2) * self.spacing
                half = rng.uniform(*self.sides, 2) / 2
                top, turn, tone = rng.uniform(0.0, self.highest), rng.uniform(0.0, np.pi), rng.uniform(*_TONES)
                if x + shift[0] - np.hypot(*half) < self.start:
                    shift[0] = self.start + np.hypot(*half) - x
                ground(
                    spec,
                    type=mujoco.mjtGeom.mjGEOM_BOX,
                    pos=[x + shift[0], y + shift[1], top / 2],
                    size=[*half, top / 2],
                    quat=[math.cos(turn / 2), 0, 0, math.sin(turn / 2)],
                    material=STONE,
                    rgba=[tone, tone, 0.98 * tone, 1.0],
                )


_NOSING = (0.02, 0.002)  # depth and height of the mark on each edge [m]


@dataclass(frozen=True)
class Stairs(World):
    """Stairs across the robot's way; not random.

    ::

                          ┌──────────────────┐        z = steps·rise
                    ┌─────┘     landing      └─────┐  z = 2·rise
              ┌─────┘                              └─────┐
        ──────┘                                          └──────
              x = start   each tread is ``tread`` deep
    """

    rise: float  # of a step [m]
    tread: float  # depth of a step [m]
    steps: int  # up, and down again; the last one up is the landing
    start: float = 0.5  # x of the first riser [m]
    landing: float = 1.2  # depth [m]
    width: float = 2.0  # [m]

    @property
    def up(self) -> list[float]:
        """X of the ascending risers [m]."""
        return [self.start + i * self.tread for i in range(self.steps)]

    @property
    def down(self) -> list[float]:
        """X of the descending risers [m]."""
        first = self.up[-1] + self.landing
        return [first + i * self.tread for i in range(self.steps)]

    def add_to(self, spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
        """Add floor and steps, one box from riser to riser, so that no gap lies under a foot."""
        floor(spec)
        half = self.width / 2
        depth, out = _NOSING
        edges = [*self.up, *self.down]
        heights = [*range(1, self.steps + 1), *range(self.steps - 1, 0, -1)]
        for begin, end, height in zip(edges, edges[1:], heights, strict=False):
            block(spec, (begin, end), (-half, half), height * self.rise, STONE)
        for x, height in zip(edges, [*range(1, self.steps + 1), *range(self.steps, 0, -1)], strict=True):
            inwards = depth / 2 if x in self.up else -depth / 2
            decoration(
                spec,
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=[x + inwards, 0, height * self.rise - depth / 2 + out],
                size=[depth / 2 + out, half, depth / 2],
                material=EDGE,
            )
