"""Faults of a robot's model.xml before it is compiled, with their location."""

import re
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from valor.common.errors import ConfigurationError
from valor.robot.description import RobotDescription
from valor.robot.tables import WHOLE_BODY_GROUPS

_COMPLAINT = re.compile(r"(?:Error: )?(?P<what>.*?)(?:\s*Element(?: name '(?P<name>[^']*)')?.*)?", re.DOTALL)
GRAVITY = (1.0, 30.0)  # downwards [m/s²]
_NEEDED = ("constraint", "equality", "limit", "contact", "gravity")
_OPTIONS = (("wind", 0, 0), ("density", 0, 2), ("viscosity", 0, 1e-3), ("iterations", 5, 1e4), ("impratio", 0.1, 1e3))
_INFINITE = re.compile(r'="(?:[-+.\deE]+\s+)*[-+]?(nan|inf)\b', re.IGNORECASE)
_LINE = re.compile(r"[Ll]ine(?: number=| )(\d+)")


def model_faults(robot: RobotDescription, spec: mujoco.MjSpec) -> Iterator[ConfigurationError]:
    """Yield every mismatch between a model and robot.yaml, with file, line and key."""
    if spec.compiler.degree:
        yield model_fault(robot, "compiler", "", "angle: expected radian, as in robot.yaml")
    yield from _option_faults(robot, spec)
    for kind in ("body", "joint", "geom", "site"):
        for element in getattr(spec, {"body": "bodies"}.get(kind, f"{kind}s")):
            if not element.name.isprintable():
                yield model_fault(robot, kind, element.name, "expected printable characters")
    free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    if len(free) != 1:
        yield model_fault(robot, "freejoint", "", f"{len(free)} free joints; expected one, the base's")
    elif (base := free[0].parent.name) != robot.tables.base:
        yield robot.error(["base"], f"got {robot.tables.base!r}; expected {base!r}, which has the free joint")
    yield from _joint_faults(robot, spec)
    yield from _unknown_names(robot, spec)
    yield from _missing_inertias(robot, spec)
    yield from _missing_files(robot, spec)
    yield from _equalities(robot, spec)


def require_finite(robot: RobotDescription) -> None:
    """Raise ConfigurationError for a NaN in model.xml: MuJoCo accepts it, and writes a log in the working folder."""
    file = robot.model_file
    text = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""
    if found := _INFINITE.search(text):
        what = f"got {found[1]}; expected finite numbers"
        raise ConfigurationError(f"{file}{_place(text, found.start(1))}: (whole file): {what}")


def _place(text: str, at: int) -> str:
    return f":{text.count(chr(10), 0, at) + 1}:{at - text.rfind(chr(10), 0, at)}"


def compile_fault(robot: RobotDescription, complaint: str) -> ConfigurationError:
    """Return MuJoCo's compile error as one line with file, line and element."""
    match = _COMPLAINT.fullmatch(complaint)
    assert match is not None  # all of it is optional
    what, name = " ".join(match["what"].split()), match["name"] or ""
    if name:
        return model_fault(robot, r"\w+", name, what)
    line = _LINE.search(complaint)
    where = f":{line[1]}:1" if line else ""
    return ConfigurationError(f"{robot.model_file}{where}: (whole file): {what}")


def model_fault(robot: RobotDescription, tag: str, name: str, what: str) -> ConfigurationError:
    """Return an error about an element of model.xml; without a location if the element is in an included file."""
    file, shown = robot.model_file, name if name.isprintable() else ascii(name)[1:-1]
    named = rf'[^>]*\b(?:name|file|joint1|body1|site1)="{re.escape(name)}"' if name else ""
    found = re.search(rf"<({tag})\b{named}", file.read_text(encoding="utf-8", errors="replace"))
    if found is None:
        return ConfigurationError(f"{file}: {'.'.join(part for part in (tag, shown) if part.isidentifier())}: {what}")
    place = _place(found.string, found.start())
    return ConfigurationError(f"{file}{place}: {'.'.join(part for part in (found[1], shown) if part)}: {what}")


def _option_faults(robot: RobotDescription, spec: mujoco.MjSpec) -> Iterator[ConfigurationError]:
    """Yield gravity that does not pull down as on a planet, and flags that switch off what holds a robot."""
    x, y, z = (float(value) for value in spec.option.gravity)
    least, most = GRAVITY
    if x or y or not -most <= z <= -least:
        what = f"gravity: got {x:g} {y:g} {z:g}; expected 0 0 -{most:g} to 0 0 -{least:g} m/s²"
        yield model_fault(robot, "option", "", what)
    for key, low, high in _OPTIONS:
        if not np.all((low <= (value := np.asarray(getattr(spec.option, key)))) & (value <= high)):
            yield model_fault(robot, "option", "", f"{key}: got {value}; expected {low:g} to {high:g}")
    flags = {name: getattr(mujoco.mjtDisableBit, f"mjDSBL_{name.upper()}") for name in _NEEDED}
    if off := [name for name, bit in flags.items() if spec.option.disableflags & bit]:
        yield model_fault(robot, "option", "", f"got flags that disable {', '.join(off)}; expected none of these")


def _joint_faults(robot: RobotDescription, spec: mujoco.MjSpec) -> Iterator[ConfigurationError]:
    """Yield hinges that only one of the two files has, and joints that are not hinges."""
    hinges = {joint.name for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE}
    for section, names in (("joints", robot.joints), ("passive", tuple(robot.tables.passive))):
        for name in names:
            if name not in hinges:
                yield robot.error([section, name], f"expected a hinge of {robot.tables.model}")
    for name in sorted(hinges - set(robot.joints) - set(robot.tables.passive)):
        yield robot.error(["joints"], f"expected all hinges of {robot.tables.model}, but for passive; missing: {name}")
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE and joint.ref:
            yield model_fault(robot, "joint", joint.name, f"got ref {joint.ref:g}; expected 0, the drawn posture")
        if joint.type in {mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_BALL} and joint.name not in robot.joints:
            yield model_fault(robot, "joint", joint.name, "expected a hinge, or none: the body welded")


def _unknown_names(robot: RobotDescription, spec: mujoco.MjSpec) -> Iterator[ConfigurationError]:
    """Yield bodies and sites that robot.yaml names and the model lacks."""
    tables = robot.tables
    known = {"body": {body.name for body in spec.bodies}, "site": {site.name for site in spec.sites}}
    known["body or site"] = known["body"] | known["site"]
    named: list[tuple[str, tuple[str, ...], str]] = [
        ("body", ("base",), tables.base),
        ("body", ("chest",), tables.chest),
        ("site", ("imu", "site"), tables.imu.site),
    ]
    named += [] if tables.kvh is None else [("site", ("kvh", "site"), tables.kvh.site)]
    named += [] if tables.head is None else [("body", ("head",), tables.head)]
    named += [] if tables.lidar is None else [("body", ("lidar", "body"), tables.lidar.body)]
    named += [] if tables.camera is None else [("body", ("camera", "body"), tables.camera.body)]
    for side, foot in (("left", tables.feet.left), ("right", tables.feet.right)):
        named += [("body", ("feet", side, "body"), foot.body), ("site", ("feet", side, "sole"), foot.sole)]
    for side, hand in tables.hands.present():
        named += [("body", ("hands", side, "body"), hand.body), ("site", ("hands", side, "site"), hand.site)]
    for i, pair in enumerate(tables.self_collision.pairs):
        named += [("body", ("self_collision", "pairs", str(i)), body) for body in pair]
    named += [("body or site", ("link_frames", frame), name) for frame, name in tables.link_frames.items()]
    for what, path, name in named:
        if name not in known[what]:
            yield robot.error(path, f"got {name!r}; expected a {what} of {tables.model}")


def _missing_inertias(robot: RobotDescription, spec: mujoco.MjSpec) -> Iterator[ConfigurationError]:
    """Yield moving bodies without explicit inertia; controllers compute without geoms."""
    for body in spec.bodies:
        if body.joints and not any(part.explicitinertial and part.mass > 0 for part in _rigid(body)):
            what = "no mass; expected an inertial: controllers compute without geoms"
            yield model_fault(robot, "body", body.name, what)


def _rigid(body: mujoco.MjsBody) -> Iterator[mujoco.MjsBody]:
    yield body
    for child in body.bodies:
        if not child.joints:
            yield from _rigid(child)


def _missing_files(robot: RobotDescription, spec: mujoco.MjSpec) -> Iterator[ConfigurationError]:
    folder = robot.model_file.parent
    for mesh in spec.meshes:
        if mesh.file and not (folder / (spec.meshdir or "") / mesh.file).is_file():
            where = Path(spec.meshdir or "") / mesh.file
            yield model_fault(robot, "mesh", mesh.file, f"no file {where} in {folder}")


def coupled(spec: mujoco.MjSpec, equality: mujoco.MjsEquality) -> list[str]:
    """Return the joints that an equality couples: those that it names, or those of the loop that it closes."""
    ends = [name for name in (equality.name1, equality.name2) if name]
    if equality.type == mujoco.mjtEq.mjEQ_JOINT:
        return ends
    chains = []
    for name in ends:
        body = spec.site(name).parent if equality.objtype == mujoco.mjtObj.mjOBJ_SITE else spec.body(name)
        chain = set()
        while body is not None and body.name != "world":
            chain |= {joint.name for joint in body.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE}
            body = body.parent
        chains.append(chain)
    return sorted(set.symmetric_difference(*chains)) if len(chains) == 2 else sorted(set().union(*chains))


def _equalities(robot: RobotDescription, spec: mujoco.MjSpec) -> Iterator[ConfigurationError]:
    """Yield couplings of whole-body joints without a passive joint; the controllers do not model them."""
    moved = {name for group in WHOLE_BODY_GROUPS for name in robot.tables.group(group)}
    for equality in spec.equalities:
        ends = [name for name in (equality.name1, equality.name2) if name]
        joints, by_joints = set(coupled(spec, equality)), equality.type == mujoco.mjtEq.mjEQ_JOINT
        if joints.intersection(robot.tables.passive) or (by_joints and not moved.intersection(joints)):
            continue
        kind = {mujoco.mjtEq.mjEQ_JOINT: "joint", mujoco.mjtEq.mjEQ_CONNECT: "connect"}.get(equality.type, r"\w+")
        what = "expected none without a passive joint: controllers treat joints of legs, waist and arms as independent"
        yield model_fault(robot, kind, ends[0] if ends else "", what)
