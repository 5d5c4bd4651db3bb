"""Source model of a robot, MJCF or URDF with floors, actuators and meshes: compiled, all joints at zero."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from valor.common.arrays import FloatArray
from valor.common.errors import ConfigurationError
from valor.robot_setup.meshes import converted

MESHES = (".stl", ".obj", ".msh", ".dae")  # read by MuJoCo or converted
_GYRATION = 1e-3  # least radius of gyration of a body whose inertia is impossible [m]
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*")  # valid in YAML, URDF and ROS
_YAML_WORDS = re.compile("(?i)null|true|false|yes|no|on|off|y|n")  # not strings in YAML
_PACKAGE = re.compile(r"package://([^/]+)/(.*)")


@dataclass(frozen=True)
class Question:
    """Question to the user about something that the model does not determine."""

    text: str  # without a question mark
    guess: str
    choices: tuple[str, ...] = ()  # empty: any name


Prompt = Callable[[Question], str]


def accept_guess(question: Question) -> str:
    """Answer a question with its guess, without the user."""
    return question.guess


class Source:
    """Compiled source model.

    Attributes:
        mj, data: compiled model, and its kinematics with all joints at zero ("as drawn").
        bodies, joints: names by id; missing or unusable names are replaced.
        notes: remarks for the user on what was renamed, guessed or left out.
        ask: answers questions.
    """

    def __init__(self, file: Path, ask: Prompt = accept_guess) -> None:
        """Read and compile a model. Raises ConfigurationError: one line that starts with the file's path."""
        self.file, self.ask = file, ask
        self.notes: list[str] = []
        self.assets: dict[str, bytes] = {}  # converted meshes of a URDF
        try:
            self.mj = self._compiled(self._spec())
        except (ValueError, OSError, ElementTree.ParseError) as error:
            raise ConfigurationError(f"{file}: {' '.join(str(error).split())}") from None
        self.data = mujoco.MjData(self.mj)
        hinges = self.mj.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE)
        self.data.qpos[self.mj.jnt_qposadr[hinges]] = 0.0  # the drawing may show them at another angle, ``ref``
        mujoco.mj_forward(self.mj, self.data)
        self.bodies = self._valid_names("body", [self.mj.body(i).name for i in range(self.mj.nbody)])
        self.joints = self._valid_names("joint", [self.mj.joint(i).name for i in range(self.mj.njnt)])

    def fail(self, problem: str) -> ConfigurationError:
        """Return an error that names the file."""
        return ConfigurationError(f"{self.file}: {problem}")

    def rotation(self, body: int) -> FloatArray:
        """Return the orientation of a body as drawn, (3, 3), in the world."""
        return np.asarray(self.data.xmat[body]).reshape(3, 3)

    def heaviest(self, bodies: Iterable[int]) -> int:
        """Return the body of the largest mass."""
        return max(bodies, key=lambda body: float(self.mj.body_mass[body]))

    def geoms(self, bodies: Iterable[int]) -> list[int]:
        """Return the geoms of bodies."""
        first, count = self.mj.body_geomadr, self.mj.body_geomnum
        return [geom for body in bodies for geom in range(first[body], first[body] + count[body])]

    def box_corners(self, geom: int) -> FloatArray:
        """Return the corners of a geom's bounding box as drawn, (8, 3) [m]."""
        signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
        return self.in_world(geom, self.mj.geom_aabb[geom, :3] + signs * self.mj.geom_aabb[geom, 3:])

    def in_world(self, geom: int, points: FloatArray) -> FloatArray:
        """Transform points (k, 3) from a geom's frame to the world, as drawn [m]."""
        rotation = self.data.geom_xmat[geom].reshape(3, 3)
        return np.asarray(self.data.geom_xpos[geom] + points @ rotation.T)

    def _valid_names(self, kind: str, names: list[str]) -> list[str]:
        """Return distinct names valid in all files."""
        used = {name for name in names if _is_valid(name)}
        found = []
        for i, name in enumerate(names):
            valid = name
            if not _is_valid(name):
                valid = re.sub(r"[^A-Za-z0-9_.-]+", "_", name).strip("_.-")
                valid = valid if _is_valid(valid) else f"{kind}_{valid or i}"
                while valid in used:
                    valid += "_"
                used.add(valid)
                if name:
                    self.notes.append(f"{kind} {name!r} is renamed to {valid}")
            found.append(valid)
        return found

    def _spec(self) -> mujoco.MjSpec:
        if not self.file.is_file():
            raise self.fail("expected a file, MJCF or URDF")
        text = self.file.read_text(encoding="utf-8", errors="replace")
        if "<robot" not in text or "<mujoco model" in text:
            spec = mujoco.MjSpec.from_file(str(self.file))
            for pair in list(spec.pairs):  # they may name the floor of another file
                spec.delete(pair)
            return spec
        robot = ElementTree.fromstring(text)
        if any(re.search(r"\$[{(]", value) for each in robot.iter() for value in each.attrib.values()):
            raise self.fail(f"is a xacro file; expected what `xacro {self.file.name}` prints")
        return mujoco.MjSpec.from_string(self._urdf(robot), assets=self.assets)

    def _compiled(self, spec: mujoco.MjSpec) -> mujoco.MjModel:
        """Compile a model; where inertias or thin meshes prevent it, with the nearest possible inertias."""
        try:
            return spec.compile()
        except ValueError as error:
            if "inertia" not in str(error):
                raise
        for mesh in spec.meshes:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.compiler.boundmass, spec.compiler.boundinertia, spec.compiler.balanceinertia = 1e-6, 1e-9, True
        names = []
        for body in spec.bodies[1:]:
            least = 1e-9 + _GYRATION**2 * body.mass
            if np.isfinite(body.fullinertia[0]):
                xx, yy, zz, xy, xz, yz = body.fullinertia
                values, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
                if values[0] < least or values[2] > values[0] + values[1]:
                    values = np.maximum(values, least)
                    values[2] = min(values[2], values[0] + values[1])
                    full = axes * values @ axes.T
                    body.fullinertia = [*np.diag(full), full[0, 1], full[0, 2], full[1, 2]]
                    names.append(body.name)
        self.notes.append(f"Inertias that no rigid body has are replaced by the nearest possible: {', '.join(names)}.")
        return spec.compile()

    def _urdf(self, robot: ElementTree.Element) -> str:
        """Return a URDF whose meshes MuJoCo reads and whose links it keeps."""
        left_out: dict[str, list[str]] = {}
        for link in robot.iter("link"):
            for child in [each for each in link if each.tag in ("visual", "collision")]:
                for shape in child.findall("geometry/*"):
                    if problem := self._take_shape(shape):
                        left_out.setdefault(problem, []).append(
                            shape.get("filename", f"{shape.tag} of {link.get('name')}")
                        )
                        link.remove(child)
        self.notes += [f"Shapes left out, {why}: {', '.join(dict.fromkeys(names))}" for why, names in left_out.items()]
        extension = robot.find("mujoco")
        extension = ElementTree.SubElement(robot, "mujoco") if extension is None else extension
        compiler = extension.find("compiler")
        compiler = ElementTree.SubElement(extension, "compiler") if compiler is None else compiler
        for key in ("strippath", "fusestatic", "discardvisual"):
            compiler.set(key, "false")
        compiler.attrib.pop("meshdir", None)
        return ElementTree.tostring(robot, encoding="unicode")

    def _take_shape(self, shape: ElementTree.Element) -> str:
        """Set the path of a mesh in a URDF, or the name of its conversion; return what a shape lacks, or empty."""
        if shape.tag != "mesh":
            sizes = " ".join(shape.get(key, "1") for key in ("size", "radius", "length"))
            return "" if min(map(float, sizes.split())) > 0 else "without size"
        path = self._mesh_path(shape.get("filename", ""))
        if path is None:
            return "no such file in the folders above the URDF"
        if path.suffix.lower() not in MESHES:
            return f"not one of {', '.join(MESHES)}"
        try:
            content = converted(path)
        except (ValueError, KeyError, ElementTree.ParseError):
            return "malformed"
        if content == b"":
            return "without triangles"
        name = str(path) if content is None else f"{len(self.assets)}_{path.stem}.stl"
        if content is not None:
            self.assets[name] = content
        shape.set("filename", name)
        return ""

    def _mesh_path(self, name: str) -> Path | None:
        """Return the path of a URDF's mesh, relative to the URDF or a folder above it, with or without the package."""
        match = _PACKAGE.fullmatch(name)
        tails = ["/".join(match.groups()), match[2]] if match else [name.removeprefix("file://")]
        paths = (folder / tail for folder in self.file.resolve().parents for tail in tails)
        return next((path for path in paths if path.is_file()), None)


def _is_valid(name: str) -> bool:
    return bool(_NAME.fullmatch(name)) and not _YAML_WORDS.fullmatch(name)
