"""Triangle meshes: COLLADA and text STL, which MuJoCo does not read, and binary STL, which it does."""

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from valor.common.arrays import FloatArray

Faces = npt.NDArray[np.int32]
Triangles = tuple[FloatArray, Faces]  # vertices (k, 3) [m], and indices (m, 3) of them

_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)")
_PRIMITIVES = {"triangles", "polylist", "polygons"}


def stl(vertices: FloatArray, faces: Faces) -> bytes:
    """Return a mesh as binary STL."""
    triangles = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    triangles["corners"] = vertices[faces]
    return b"\0" * 80 + np.uint32(len(faces)).tobytes() + triangles.tobytes()


def converted(file: Path) -> bytes | None:
    """Return a COLLADA file or a text STL as binary STL, empty without triangles; None for other files.

    Raises ValueError: the file is malformed.
    """
    if file.suffix.lower() == ".dae":
        return _Collada(ElementTree.parse(file).getroot()).stl()
    content = file.read_bytes() if file.suffix.lower() == ".stl" else b""
    if not content.lstrip().startswith(b"solid") or not (corners := _VERTEX.findall(content)):
        return None
    vertices = np.array(corners, dtype=np.float64)
    return stl(vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))


class _Collada:
    """COLLADA 1.4 document. The up axis is not applied, as in ROS' viewers."""

    def __init__(self, root: ElementTree.Element) -> None:
        for element in root.iter():
            element.tag = element.tag.rpartition("}")[2]
        unit = root.find("asset/unit")
        self.unit = 1.0 if unit is None else float(unit.get("meter", "1"))
        self.root = root
        self.by_id = {f"#{element.get('id')}": element for element in root.iter() if element.get("id")}

    def stl(self) -> bytes:
        parts = [part for scene in self.root.iter("visual_scene") for part in self.node(scene, np.eye(4))]
        corners = np.concatenate(parts) * self.unit if parts else np.zeros((0, 3))
        return stl(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3)) if len(corners) else b""

    def node(self, node: ElementTree.Element, parent: FloatArray) -> list[FloatArray]:
        """Return the corners of the triangles of a node and its descendants, (3 m, 3) each, in the file's unit."""
        pose, found = parent, []
        for child in node:
            if child.tag in {"matrix", "translate", "rotate", "scale"}:
                pose = pose @ _transform(child.tag, np.array((child.text or "").split(), dtype=np.float64))
        for child in node:
            target = self.by_id.get(child.get("url", ""))
            if child.tag == "node":
                found += self.node(child, pose)
            elif child.tag == "instance_node" and target is not None:
                found += self.node(target, pose)
            elif child.tag == "instance_geometry" and target is not None:
                found += [corners @ pose[:3, :3].T + pose[:3, 3] for corners in self.geometry(target)]
        return found

    def geometry(self, geometry: ElementTree.Element) -> list[FloatArray]:
        return [
            self.triangles(each) for each in geometry.iter() if each.tag in _PRIMITIVES and each.find("p") is not None
        ]

    def triangles(self, primitive: ElementTree.Element) -> FloatArray:
        """Return the corners of triangles, (3 m, 3); polygons are divided into fans."""
        inputs = {each.get("semantic"): each for each in primitive.iter("input")}
        stride = 1 + max(int(each.get("offset", "0")) for each in inputs.values())
        positions = self.by_id[inputs["VERTEX"].get("source", "")].find("input[@semantic='POSITION']")
        values = None if positions is None else self.by_id[positions.get("source", "")].find("float_array")
        points = np.array((values.text or "").split() if values is not None else [], dtype=np.float64).reshape(-1, 3)
        lists = [np.array((p.text or "").split(), dtype=np.int64).reshape(-1, stride) for p in primitive.iter("p")]
        lists = [each[:, int(inputs["VERTEX"].get("offset", "0"))] for each in lists]
        if (counts := primitive.find("vcount")) is not None:
            lists = np.split(lists[0], np.cumsum(np.array((counts.text or "").split(), dtype=np.int64))[:-1])
        elif primitive.tag == "triangles":
            return points[np.concatenate(lists)]
        fans = [polygon[[0, i, i + 1]] for polygon in lists for i in range(1, len(polygon) - 1)]
        return points[np.concatenate(fans)] if fans else np.zeros((0, 3))


def _transform(kind: str, values: FloatArray) -> FloatArray:
    """Return the matrix (4, 4) of a COLLADA transformation."""
    found = np.eye(4)
    if kind == "matrix":
        return values.reshape(4, 4)
    if kind == "translate":
        found[:3, 3] = values
    elif kind == "scale":
        found[:3, :3] = np.diag(values)
    else:
        (x, y, z), angle = values[:3] / np.linalg.norm(values[:3]), np.radians(values[3])
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        found[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return found
