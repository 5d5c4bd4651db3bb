"""Headers, and clouds of points."""

import array

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

_TYPES = {"f": PointField.FLOAT32, "i": PointField.INT32}


def header(stamp: int, frame: str) -> Header:
    """Return a header; ``stamp``: robot time [ns]."""
    made = Header(frame_id=frame)
    made.stamp.sec, made.stamp.nanosec = divmod(stamp, 1_000_000_000)
    return made


def cloud(head: Header, points: npt.NDArray[np.void]) -> PointCloud2:
    """Return a cloud of (k,) structured points, whose fields have four bytes each."""
    kinds = points.dtype
    fields = [
        PointField(name=name, offset=4 * i, datatype=_TYPES[kinds[name].kind], count=1)
        for i, name in enumerate(kinds.names or ())
    ]
    return PointCloud2(
        header=head, height=1, width=points.size, fields=fields, point_step=kinds.itemsize,
        row_step=points.nbytes, data=array.array("B", points.tobytes()), is_dense=True,
    )  # fmt: skip
