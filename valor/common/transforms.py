"""Buffer of transforms between frames over time, like tf2's, without ROS.

Each frame has one parent. Lookups are within the stored history, or at the latest time common to all transforms needed.
"""

import math
from bisect import bisect_left
from collections.abc import Iterable

from valor.common.errors import ValorError
from valor.common.poses import Pose, interpolate

LONGEST_WAY = 200  # frames from one to the root; a longer chain is taken for a loop


class TransformError(ValorError):
    """The pose of a frame cannot be determined."""


class TooNewError(TransformError):
    """No transform of that time has arrived yet."""


class _Edge:
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
            self.times, self.poses = [], []  # the clock has restarted
        index = bisect_left(self.times, time)
        if index < len(self.times) and self.times[index] == time:
            self.poses[index] = pose
        else:
            self.times.insert(index, time)
            self.poses.insert(index, pose)
        oldest = bisect_left(self.times, self.times[-1] - history)
        del self.times[:oldest], self.poses[:oldest]

    def at(self, time: int) -> Pose:
        """The pose at a time within the stored history."""
        if self.static:
            return self.poses[0]
        index = bisect_left(self.times, time)
        if self.times[index] == time:
            return self.poses[index]
        before, after = self.times[index - 1], self.times[index]
        return interpolate(self.poses[index - 1], self.poses[index], (time - before) / (after - before))


class TransformBuffer:
    """Received transforms of the last seconds."""

    def __init__(self, history: float = 10.0) -> None:
        """Start empty; ``history``: time that transforms are stored [s]."""
        self._history = round(history * 1e9)
        self._edges: dict[str, _Edge] = {}

    def add(self, parent: str, child: str, time: int, pose: Pose, *, static: bool = False) -> None:
        """Store the pose of the frame ``child`` in ``parent`` at a time [ns], or, if static, for all times.

        The orientation's norm must be 1 within 1 %; it is normalised. Raises ValueError, and stores nothing: not
        finite, no orientation, or not two named frames.
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

        ``time``: [ns]; 0: the latest that all transforms between the frames have. Raises TooNewError: not received yet;
        TransformError: unknown or unconnected frames, or a time before the stored history.
        """
        target, source = target.lstrip("/"), source.lstrip("/")
        known = {edge.parent for edge in self._edges.values()} | self._edges.keys()
        for frame in (source, target):
            if frame not in known:
                raise TransformError(f"frame {frame!r} is unknown to tf")
        up, down = self._way(source), self._way(target)
        if up[-1] != down[-1]:
            raise TransformError(f"frames {source!r} and {target!r} are not connected in tf")
        while up and down and up[-1] == down[-1]:
            up.pop()
            down.pop()
        time = self._time((*up, *down), time, source, target)
        return self._chain(down, time).inverse() @ self._chain(up, time)

    def _way(self, frame: str) -> list[str]:
        way = [frame]
        while (edge := self._edges.get(way[-1])) is not None:
            way.append(edge.parent)
            if len(way) > LONGEST_WAY:
                raise TransformError(f"the parents of frame {frame!r} go in a circle in tf")
        return way

    def _time(self, frames: Iterable[str], time: int, source: str, target: str) -> int:
        moving = [edge for frame in frames if not (edge := self._edges[frame]).static]
        if not moving:
            return time
        latest, oldest = min(edge.times[-1] for edge in moving), max(edge.times[0] for edge in moving)
        if time == 0:
            time = latest
        way = f"from {source!r} to {target!r}"
        if time > latest:
            raise TooNewError(f"{way}: {_s(time)} is {_s(time - latest)} ahead of the latest transform")
        if time < oldest:
            raise TransformError(f"{way}: {_s(time)} is {_s(oldest - time)} before the oldest stored transform")
        return time

    def _chain(self, way: list[str], time: int) -> Pose:
        pose = Pose()
        for frame in way:
            pose = self._edges[frame].at(time) @ pose
        return pose


def _s(nanoseconds: int) -> str:
    return f"{nanoseconds * 1e-9:.3f} s"
