"""A robot's model as it comes, MJCF or URDF with floors, actuators and meshes: compiled, all joints at zero."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError

MESHES = (".stl", ".obj", ".msh")  # that MuJoCo reads
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*")  # that YAML, URDF and ROS take as it is
_WORDS = re.compile("(?i)null|true|false|yes|no|on|off|y|n")  # that YAML takes for something else
_PACKAGE = re.compile(r"package://([^/]+)/(.*)")


def _is_plain(name: str) -> bool:
    return bool(_NAME.fullmatch(name)) and not _WORDS.fullmatch(name)


class Source:
    """A model as its maker drew it, all joints at zero.

    Attributes:
        file: where it stands.
        mj: the compiled model.
        data: its kinematics with all joints at zero.
        bodies, joints: names by id; what has none, or one that is no plain word, is given one.
        notes: what was left out of it, for people.
    """

    def __init__(self, file: Path) -> None:
        """Read and compile a model.

        Raises:
            ConfigurationError: it cannot be read, or not compiled; in one line, with the file.
        """
        self.file = file
        self.notes: list[str] = []
        try:
            self.mj = self._spec().compile()
        except (ValueError, OSError, ElementTree.ParseError) as error:
            raise ConfigurationError(f"{file}: {' '.join(str(error).split())}") from None
        self.data = mujoco.MjData(self.mj)
        turning = self.mj.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE)
        self.data.qpos[self.mj.jnt_qposadr[turning]] = 0.0  # they may be drawn elsewhere, at their ``ref``
        mujoco.mj_forward(self.mj, self.data)
        self.bodies = self._plain("body", [self.mj.body(i).name for i in range(self.mj.nbody)])
        self.joints = self._plain("joint", [self.mj.joint(i).name for i in range(self.mj.njnt)])

    def _plain(self, kind: str, names: list[str]) -> list[str]:
        """Names that are different plain words."""
        kept = {name for name in names if _is_plain(name)}
        found = []
        for i, name in enumerate(names):
            plain = name
            if not _is_plain(name):
                plain = re.sub(r"[^A-Za-z0-9_.-]+", "_", name).strip("_.-")
                plain = plain if _is_plain(plain) else f"{kind}_{plain or i}"
                while plain in kept:
                    plain += "_"
                kept.add(plain)
                if name:
                    self.notes.append(f"{kind} {name!r} is called {plain}")
            found.append(plain)
        return found

    def _spec(self) -> mujoco.MjSpec:
        if not self.file.is_file():
            raise ConfigurationError(f"{self.file}: expected a file, MJCF or URDF")
        text = self.file.read_text(encoding="utf-8", errors="replace")
        if "<robot" not in text or "<mujoco model" in text:
            spec = mujoco.MjSpec.from_file(str(self.file))
            for pair in list(spec.pairs):  # with floors that stand in another file
                spec.delete(pair)
            return spec
        if "xacro:" in text:
            raise ConfigurationError(f"{self.file}: is a xacro file; expected what `xacro {self.file.name}` prints")
        return mujoco.MjSpec.from_string(self._urdf(ElementTree.fromstring(text)))

    def _urdf(self, robot: ElementTree.Element) -> str:
        """URDF such that MuJoCo finds its meshes, and keeps its links."""
        for parent in list(robot.iter()):
            for child in list(parent):
                for mesh in child.iter("mesh") if child.tag in ("visual", "collision") else ():
                    path = self._mesh(mesh.get("filename", ""))
                    mesh.set("filename", str(path))
                    if path.suffix.lower() not in MESHES:
                        self.notes.append(f"{child.tag} mesh {path.name} left out: expected one of {', '.join(MESHES)}")
                        parent.remove(child)
        extension = robot.find("mujoco")
        extension = ElementTree.SubElement(robot, "mujoco") if extension is None else extension
        compiler = extension.find("compiler")
        compiler = ElementTree.SubElement(extension, "compiler") if compiler is None else compiler
        for key, value in (("strippath", "false"), ("fusestatic", "false"), ("discardvisual", "false")):
            compiler.set(key, value)
        compiler.attrib.pop("meshdir", None)
        return ElementTree.tostring(robot, encoding="unicode")

    def _mesh(self, name: str) -> Path:
        """Where a mesh of a URDF stands: beside it, or in the ROS package above it."""
        if match := _PACKAGE.fullmatch(name):
            package, rest = match.groups()
            for folder in self.file.resolve().parents:
                for base in (folder, folder / package):
                    if (base / rest).is_file() and (base.name == package or (base / "package.xml").is_file()):
                        return base / rest
            return self.file.resolve().parent / rest
        return self.file.resolve().parent / name.removeprefix("file://")

    def rotation(self, body: int) -> FloatArray:
        """(3, 3) of a body as drawn, in the world."""
        return np.asarray(self.data.xmat[body]).reshape(3, 3)
