"""Which frame is where, and was a little while ago: what tf2's buffer is to ROS, without ROS.

The transforms make a tree: each frame has one parent. Where two frames are relative to one another is asked at a time
within what has been heard, or at the newest time at which the whole way between them is known.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable

from valor.common.errors import ValorError
from valor.common.poses import Pose, interpolate

LONGEST_WAY = 200  # frames from one to the root; longer: they go in a circle


class TransformError(ValorError):
    """Where a frame is cannot be said."""


class TooNewError(TransformError):
    """Not yet: no transform that new has been heard."""


class _Edge:
    """A frame in its parent, over time."""

    def __init__(self, parent: str, static: bool) -> None:
        self.parent = parent
        self.static = static
        self.times: list[int] = []
        self.poses: list[Pose] = []

    def add(self, time: int, pose: Pose, history: int) -> None:
        if self.static:
            self.times, self.poses = [time], [pose]
            return
        if self.times and time < self.times[-1] - history:
            self.times, self.poses = [], []  # the clock has begun anew
        place = bisect_left(self.times, time)
        if place < len(self.times) and self.times[place] == time:
            self.poses[place] = pose
        else:
            self.times.insert(place, time)
            self.poses.insert(place, pose)
        oldest = bisect_left(self.times, self.times[-1] - history)
        del self.times[:oldest], self.poses[:oldest]

    def at(self, time: int) -> Pose:
        """The pose at a time within what is known."""
        if self.static:
            return self.poses[0]
        place = bisect_left(self.times, time)
        if self.times[place] == time:
            return self.poses[place]
        before, after = self.times[place - 1], self.times[place]
        return interpolate(self.poses[place - 1], self.poses[place], (time - before) / (after - before))


class TransformBuffer:
    """Transforms as they are heard, for a while."""

    def __init__(self, history: float = 10.0) -> None:
        """Args: history: for how long transforms are kept [s]."""
        self._history = round(history * 1e9)
        self._edges: dict[str, _Edge] = {}

    def add(self, parent: str, child: str, time: int, pose: Pose, *, static: bool = False) -> None:
        """Take a transform.

        Args:
            parent: the frame that the pose is in.
            child: the frame whose pose it is.
            time: of it [ns].
            pose: of norm 1 within 1 %, then normalised.
            static: for all times.

        Raises:
            ValueError: not finite, no orientation, or a frame without name or in itself; nothing has changed.
        """
        parent, child = parent.lstrip("/"), child.lstrip("/")
        norm = math.hypot(*pose.orientation)
        if not parent or not child or parent == child:
            raise ValueError(f"transform from {parent!r} to {child!r}: expected two frames")
        if not (all(map(math.isfinite, pose.position)) and abs(norm - 1.0) < 0.01):
            raise ValueError(f"transform from {parent!r} to {child!r} is not finite, or its rotation has norm {norm}")
        w, x, y, z = (each / norm for each in pose.orientation)
        edge = self._edges.get(child)
        if edge is None or edge.parent != parent or edge.static != static:
            edge = self._edges[child] = _Edge(parent, static)
        edge.add(time, Pose(pose.position, (w, x, y, z)), self._history)

    def lookup(self, target: str, source: str, time: int = 0) -> Pose:
        """The pose of the frame ``source`` in the frame ``target``.

        Args:
            target: as what the pose is in.
            source: whose it is.
            time: [ns]; 0: the newest at which all of it is known.

        Raises:
            TooNewError: nothing so new has been heard yet.
            TransformError: unknown or unconnected frames, or a time that is forgotten.
        """
        target, source = target.lstrip("/"), source.lstrip("/")
        known = {edge.parent for edge in self._edges.values()} | self._edges.keys()
        for frame in (source, target):
            if frame not in known:
                raise TransformError(f"frame {frame!r} is not known to tf")
        up, down = self._way(source), self._way(target)
        if up[-1] != down[-1]:
            raise TransformError(f"frames {source!r} and {target!r} are not connected in tf")
        while up and down and up[-1] == down[-1]:
            up.pop()
            down.pop()
        time = self._time((*up, *down), time, source, target)
        return self._chain(down, time).inverse() @ self._chain(up, time)

    def _way(self, frame: str) -> list[str]:
        """A frame, its parent, and so on to the root."""
        way = [frame]
        while (edge := self._edges.get(way[-1])) is not None:
            way.append(edge.parent)
            if len(way) > LONGEST_WAY:
                raise TransformError(f"the parents of frame {frame!r} go in a circle in tf")
        return way

    def _time(self, frames: Iterable[str], time: int, source: str, target: str) -> int:
        """The time to ask at, which every transform on the way knows."""
        moving = [edge for frame in frames if not (edge := self._edges[frame]).static]
        if not moving:
            return time
        newest, oldest = min(edge.times[-1] for edge in moving), max(edge.times[0] for edge in moving)
        if time == 0:
            time = newest
        way = f"from {source!r} to {target!r}"
        if time > newest:
            raise TooNewError(f"{way}: {_s(time)} is {_s(time - newest)} ahead of the newest transform")
        if time < oldest:
            raise TransformError(f"{way}: {_s(time)} is {_s(oldest - time)} before the oldest transform that is kept")
        return time

    def _chain(self, way: list[str], time: int) -> Pose:
        """The first frame of a way in the last one's parent."""
        pose = Pose()
        for frame in way:
            pose = self._edges[frame].at(time) @ pose
        return pose


def _s(nanoseconds: int) -> str:
    return f"{nanoseconds * 1e-9:.3f} s"
