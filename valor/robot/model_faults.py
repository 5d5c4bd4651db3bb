"""What is wrong with a robot's model.xml before it is compiled, and where."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import mujoco

from valor.common.errors import ConfigurationError
from valor.robot.description import RobotDescription
from valor.robot.tables import WHOLE_BODY_GROUPS

_COMPLAINT = re.compile(r"(?:Error: )?(?P<what>.*?)(?:\s*Element(?: name '(?P<name>[^']*)')?.*)?", re.DOTALL)
_LINE = re.compile(r"[Ll]ine(?: number=| )(\d+)")


def model_faults(robot: RobotDescription, spec: mujoco.MjSpec) -> Iterator[ConfigurationError]:
    """All that keeps a model from being that of robot.yaml, each with file, line and key."""
    if spec.compiler.degree:
        yield _fault(robot, "compiler", "", "angle: expected radian, as in robot.yaml")
    free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    if len(free) != 1:
        yield _fault(robot, "freejoint", "", f"{len(free)} free joints; expected one, the base's")
    elif (base := free[0].parent.name) != robot.tables.base:
        yield robot.error(["base"], f"got {robot.tables.base!r}; expected {base!r}, which has the free joint")
    yield from _strange_joints(robot, spec)
    yield from _unknown_names(robot, spec)
    yield from _massless(robot, spec)
    yield from _missing_files(robot, spec)
    yield from _equalities(robot, spec)


def compile_fault(robot: RobotDescription, complaint: str) -> ConfigurationError:
    """MuJoCo's complaint in one line, with file, line and what it is about."""
    match = _COMPLAINT.fullmatch(complaint)
    assert match is not None  # all of it is optional
    what, name = " ".join(match["what"].split()), match["name"] or ""
    if name:
        return _fault(robot, r"\w+", name, what)
    line = _LINE.search(complaint)
    where = f":{line[1]}:1" if line else ""
    return ConfigurationError(f"{robot.model_file}{where}: (whole file): {what}")


def _fault(robot: RobotDescription, tag: str, name: str, what: str) -> ConfigurationError:
    """One line about an element of model.xml; without a place where that is in a file which it includes."""
    file = robot.model_file
    named = rf'[^>]*\b(?:name|file|joint1|body1|site1)="{re.escape(name)}"' if name else ""
    found = re.search(rf"<({tag})\b{named}", file.read_text(encoding="utf-8", errors="replace"))
    if found is None:
        return ConfigurationError(f"{file}: {'.'.join(part for part in (tag, name) if part.isidentifier())}: {what}")
    before = found.string[: found.start()]
    place = f"{before.count(chr(10)) + 1}:{found.start() - before.rfind(chr(10))}"
    return ConfigurationError(f"{file}:{place}: {'.'.join(part for part in (found[1], name) if part)}: {what}")


def _strange_joints(robot: RobotDescription, spec: mujoco.MjSpec) -> Iterator[ConfigurationError]:
    """Hinges of one file alone, and joints that are no hinges."""
    hinges = {joint.name for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_HINGE}
    for name in robot.joints:
        if name not in hinges:
            yield robot.error(["joints", name], f"expected a hinge of {robot.tables.model}")
    for name in robot.tables.passive:
        if name not in hinges:
            yield robot.error(["passive", name], f"expected a hinge of {robot.tables.model}")
    for name in sorted(hinges - set(robot.joints) - set(robot.tables.passive)):
        yield robot.error(["joints"], f"expected all hinges of {robot.tables.model}, but for passive; missing: {name}")
    for joint in spec.joints:
        if joint.type in {mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_BALL} and joint.name not in robot.joints:
            yield _fault(robot, "joint", joint.name, "expected a hinge, or none: the body welded")


def _unknown_names(robot: RobotDescription, spec: mujoco.MjSpec) -> Iterator[ConfigurationError]:
    """Every body and site that robot.yaml names is in the model."""
    tables, model = robot.tables, robot.tables.model
    bodies, sites = {body.name for body in spec.bodies}, {site.name for site in spec.sites}
    feet = [("left", tables.feet.left), ("right", tables.feet.right)]
    hands = list(tables.hands.present())
    named_bodies: list[tuple[tuple[str, ...], str]] = [
        (("base",), tables.base),
        (("chest",), tables.chest),
        *([] if tables.head is None else [(("head",), tables.head)]),
        *((("feet", side, "body"), foot.body) for side, foot in feet),
        *((("hands", side, "body"), hand.body) for side, hand in hands),
        *(
            (("self_collision", "pairs", str(i)), body)
            for i, pair in enumerate(tables.self_collision.pairs)
            for body in pair
        ),
    ]
    named_sites: list[tuple[tuple[str, ...], str]] = [
        (("imu", "site"), tables.imu.site),
        *((("feet", side, "sole"), foot.sole) for side, foot in feet),
        *((("hands", side, "site"), hand.site) for side, hand in hands),
    ]
    named_frames = [(("link_frames", frame), name) for frame, name in tables.link_frames.items()]
    for what, known, named in (
        ("body", bodies, named_bodies),
        ("site", sites, named_sites),
        ("body or site", bodies | sites, named_frames),
    ):
        for path, name in named:
            if name not in known:
                yield robot.error(path, f"got {name!r}; expected a {what} of {model}")


def _massless(robot: RobotDescription, spec: mujoco.MjSpec) -> Iterator[ConfigurationError]:
    """Bodies that move and have no inertia of their own: controllers compute without geoms."""
    for body in spec.bodies:
        if body.joints and not any(part.explicitinertial and part.mass > 0 for part in _rigid(body)):
            what = "no mass; expected an inertial, for controllers compute without geoms"
            yield _fault(robot, "body", body.name, what)


def _rigid(body: mujoco.MjsBody) -> Iterator[mujoco.MjsBody]:
    """A body, and those that are fixed to it."""
    yield body
    for child in body.bodies:
        if not child.joints:
            yield from _rigid(child)


def _missing_files(robot: RobotDescription, spec: mujoco.MjSpec) -> Iterator[ConfigurationError]:
    """Meshes that are not there."""
    folder = robot.model_file.parent
    for mesh in spec.meshes:
        if mesh.file and not (folder / (spec.meshdir or "") / mesh.file).is_file():
            where = Path(spec.meshdir or "") / mesh.file
            yield _fault(robot, "mesh", mesh.file, f"no file {where} in {folder}")


def coupled(spec: mujoco.MjSpec, equality: mujoco.MjsEquality) -> list[str]:
    """Names of the joints that an equality couples: those that it names, or those of the loop that it closes."""
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
    """What couples joints of the whole body with no passive one between them: controllers know nothing of it."""
    moved = {name for group in WHOLE_BODY_GROUPS for name in robot.tables.group(group)}
    for equality in spec.equalities:
        ends = [name for name in (equality.name1, equality.name2) if name]
        joints, by_joints = set(coupled(spec, equality)), equality.type == mujoco.mjtEq.mjEQ_JOINT
        if joints.intersection(robot.tables.passive) or (by_joints and not moved.intersection(joints)):
            continue
        kind = {mujoco.mjtEq.mjEQ_JOINT: "joint", mujoco.mjtEq.mjEQ_CONNECT: "connect"}.get(equality.type, r"\w+")
        what = "expected none without a passive joint: controllers take those of legs, waist and arms for independent"
        yield _fault(robot, kind, ends[0] if ends else "", what)
