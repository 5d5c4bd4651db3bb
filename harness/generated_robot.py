"""Humanoids that nobody has drawn: MJCF of one of any size, built in any of the ways in which makers build theirs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Literal
from xml.etree import ElementTree

import numpy as np

from valor.common.arrays import FloatArray

Point = Sequence[float] | FloatArray
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_ARM = "yxzyzyx"  # axes from the shoulder out
_HIP = {"z": (-0.7, 0.7), "x": (-0.6, 0.6), "y": (-2.0, 1.0)}  # limits [rad]


@dataclass(frozen=True)
class Build:
    """How a robot is built.

    Attributes:
        mass: of all [kg].
        leg: from hip to ankle [m].
        root: the body that all others hang from.
        waist, hip: axes of the joints from the pelvis up, and from it down to the thigh.
        leg_joints: the last of six left out where fewer.
        legs: sides that have one.
        arm: joints; 0: no arms.
        neck, fingers: whether there are any; of fingers one is driven and one follows it by an equality.
        spring: whether an antenna is on a hinge that nothing drives.
        toes: whether the front of a sole is on a sprung hinge that nothing drives.
        linkage: whether a rod beside each shin, on two hinges that nothing drives, ends on the shin in a loop.
        knee: sign of its angle when bent.
        mirrored: whether the right side's axes are the left ones' opposites.
        drive: actuators; none: joints have limits alone.
        gear: of a motor.
        sole: what touches the ground.
        narrow: share of a usual sole's width.
        ankle: how far it turns sideways, either way [rad].
        together: whether joints that turn in one point are on one body.
        shuffled: whether actuators come in another order than joints.
        named: whether anything has a name.
        degrees: whether angles are.
        floor, keyframe, floating, sensors: whether there is one.
        heading: which way it looks, from x [rad].
        uneven: of places of centres of mass, and of the sides' masses, a share.
    """

    mass: float = 50.0
    leg: float = 0.7
    root: Literal["pelvis", "chest"] = "pelvis"
    waist: str = "z"
    hip: str = "zxy"
    leg_joints: int = 6
    legs: tuple[str, ...] = ("left", "right")
    arm: int = 4
    neck: bool = True
    fingers: bool = False
    spring: bool = False
    toes: bool = False
    linkage: bool = False
    knee: Literal[1, -1] = 1
    mirrored: bool = False
    drive: Literal["motor", "position", "none"] = "motor"
    gear: float = 1.0
    sole: Literal["points", "box", "mesh", "capsules", "none"] = "box"
    narrow: float = 1.0
    ankle: float = 0.5
    together: bool = False
    shuffled: bool = False
    named: bool = True
    degrees: bool = False
    floor: bool = False
    keyframe: bool = False
    floating: bool = True
    sensors: bool = False
    heading: float = 0.0
    uneven: float = 0.0

    @property
    def heel_toe_half_width(self) -> tuple[float, float, float]:
        """Of the sole's edges, from below the ankle [m]."""
        return -0.1 * self.leg, 0.19 * self.leg, 0.075 * self.leg * self.narrow


def mjcf(build: Build) -> str:
    """The model."""
    return _Maker(build).text()


@dataclass
class _Maker:
    build: Build
    driven: list[tuple[str, float]] = field(default_factory=list)  # joint, effort [N·m]
    count: int = 0
    loops: list[tuple[str, str, FloatArray]] = field(default_factory=list)  # bodies, and the point in the first [m]

    def text(self) -> str:
        build, size = self.build, self.build.leg
        self.random = np.random.default_rng(1)
        model = ElementTree.Element("mujoco", model="generated")
        ElementTree.SubElement(model, "compiler", angle="degree" if build.degrees else "radian", autolimits="true")
        if build.sole == "mesh":
            heel, toe, half = build.heel_toe_half_width
            corners = product((heel, toe), (-half, half), (-0.1 * size, -0.07 * size))
            # Narrower above, as soles of feet are.
            points = [(x, y * (1 if z < -0.08 * size else 0.7), z) for x, y, z in corners]
            asset = ElementTree.SubElement(model, "asset")
            ElementTree.SubElement(asset, "mesh", name="foot", vertex=" ".join(map(_text, points)))
        world = ElementTree.SubElement(model, "worldbody")
        if build.floor:
            ElementTree.SubElement(world, "geom", type="plane", size="0 0 0.05", name="floor")
        self.trunk(world)
        if self.driven and build.drive != "none":
            self.actuators(model)
        equality = ElementTree.SubElement(model, "equality")
        for one, other, point in self.loops:
            ElementTree.SubElement(equality, "connect", body1=one, body2=other, anchor=_text(point))
        if build.fingers and build.arm:
            for side in build.legs:
                ElementTree.SubElement(
                    equality, "joint", joint1=f"{side}_finger_tip", joint2=f"{side}_finger", polycoef="0 1 0 0 0"
                )
        if build.sensors:
            sensor = ElementTree.SubElement(model, "sensor")
            ElementTree.SubElement(sensor, "gyro", name="gyro", site="maker_imu")
        if build.keyframe:
            joints = sum(1 for _ in model.iter("joint")) - 2 * build.fingers * (build.arm > 0)
            key = ElementTree.SubElement(model, "keyframe")
            free = [0.0, 0.0, size, 1.0, 0.0, 0.0, 0.0] if build.floating else []
            ElementTree.SubElement(key, "key", name="home", qpos=_text([*free, *[0.1] * joints]))
        return ElementTree.tostring(model, encoding="unicode")

    def trunk(self, world: ElementTree.Element) -> None:
        """Pelvis, waist and chest, from the root on, and what hangs from them."""
        build, size = self.build, self.build.leg
        hips, waist = np.array([0, 0, 1.1 * size]), np.array([0, 0, 1.25 * size])
        chest_at = waist + np.array([0, 0, 0.25 * size])
        turns = [("waist", axis, -0.6, 0.6, 0.3) for axis in build.waist]
        pelvis_size, chest_size = (0.1, 0.12, 0.08), (0.1, 0.18, 0.22)
        first = ("pelvis", hips, 0.16, pelvis_size) if build.root == "pelvis" else ("chest", chest_at, 0.3, chest_size)
        last = ("chest", chest_at, 0.3, chest_size) if build.root == "pelvis" else ("pelvis", hips, 0.16, pelvis_size)
        name, at, share, shape = first
        root = self.body(world, name, at, np.zeros(3), share)
        half = build.heading / 2
        root.set("quat", _text([np.cos(half), 0, 0, np.sin(half)]))
        if build.floating:
            root.append(ElementTree.Element("freejoint"))
        if build.sensors:
            ElementTree.SubElement(root, "site", name="maker_imu")
        self.box(root, shape)
        if turns:
            end = self.chain(root, at, last[0], last[1], last[2], turns, waist)
            self.box(end, last[3])
        else:  # the other part of the trunk is welded to it
            end = self.body(root, last[0], last[1], at, last[2])
            self.box(end, last[3])
        pelvis, chest = (root, end) if build.root == "pelvis" else (end, root)
        for side in build.legs:
            self.leg(pelvis, hips, side)
            if build.arm:
                self.arm(chest, chest_at, side)
        if build.neck:
            up = np.array([0, 0, 0.35 * size])
            turns = [("neck", "z", -1.2, 1.2, 0.03), ("neck", "y", -0.5, 0.5, 0.03)]
            self.box(self.chain(chest, chest_at, "head", chest_at + up, 0.03, turns), (0.08, 0.08, 0.1))
        if build.spring:
            antenna = self.body(chest, "antenna", chest_at + np.array([-0.2 * size, 0, 0.3 * size]), chest_at, 0.002)
            self.joint(antenna, "antenna", "y", -0.5, 0.5, None).set("stiffness", "0.1")
            self.box(antenna, (0.01, 0.01, 0.1))

    def leg(self, pelvis: ElementTree.Element, hips: FloatArray, side: str) -> None:
        build, size = self.build, self.build.leg
        sign = 1 if side == "left" else -1
        flip = -1 if build.mirrored and side == "right" else 1
        at = hips + np.array([0, sign * 0.14 * size, 0])
        turns = [(f"{side}_hip", axis, *_HIP[axis], 0.4) for axis in build.hip]
        thigh = self.chain(pelvis, hips, f"{side}_thigh", at, 0.1, turns, flip=flip)
        self.rod(thigh, 0.45 * size, 0.07 * size)
        knee = at - np.array([0, 0, size / 2])
        limits = (0.0, 2.2) if build.knee > 0 else (-2.2, 0.0)
        turn = [(f"{side}_knee", "y" if build.knee > 0 else "-y", *limits, 0.5)]
        shin = self.chain(thigh, at, f"{side}_shin", knee, 0.07, turn, flip=flip)
        self.rod(shin, 0.42 * size, 0.055 * size)
        ankle = knee - np.array([0, 0, size / 2])
        turns = [(f"{side}_ankle", "y", -0.9, 0.9, 0.25), (f"{side}_ankle", "x", -build.ankle, build.ankle, 0.2)]
        turns = turns[: build.leg_joints - 4]
        foot = self.chain(shin, knee, f"{side}_foot", ankle, 0.03, turns, flip=flip)
        self.sole(foot)
        if build.toes:
            _, toe, half = build.heel_toe_half_width
            tip, where = 0.06 * size, ankle + np.array([toe, 0, -0.085 * size])
            front = self.body(foot, f"{side}_toe", where, ankle, 0.004)
            spring = self.joint(front, f"{side}_toe", "y", -0.5, 0.1, None)
            spring.set("stiffness", f"{0.15 * build.mass * 9.81 * tip:.4g}")
            spring.set("damping", f"{0.003 * build.mass * 9.81 * tip:.4g}")
            shape = _text([tip / 2 - 0.002 * size, half, 0.01 * size])
            ElementTree.SubElement(front, "geom", type="box", pos=_text([tip / 2, 0, -0.005 * size]), size=shape)
        if build.linkage:
            self.linkage(thigh, shin, at, knee, side)

    def linkage(
        self, thigh: ElementTree.Element, shin: ElementTree.Element, hip: FloatArray, knee: FloatArray, side: str
    ) -> None:
        """A parallelogram: half the thigh, a crank, the rod, and the shin, on which it ends."""
        size = self.build.leg
        top = hip - np.array([0, 0, 0.25 * size])
        lever = 0.08 * size * np.array([-np.sqrt(0.5), 0, -np.sqrt(0.5)])
        crank = self.body(thigh, f"{side}_crank", top, hip, 0.002)
        rod = self.body(crank, f"{side}_rod", top + lever, top, 0.002)
        for body, name in ((crank, "crank"), (rod, "rod")):
            self.joint(body, f"{side}_{name}", "y", -3.0, 3.0, None).set("damping", f"{1e-4 * self.build.mass:.4g}")
        ends = _text([0, 0, 0, 0, 0, -0.25 * size])
        seen = ElementTree.SubElement(rod, "geom", type="capsule", contype="0", conaffinity="0", fromto=ends)
        seen.set("size", f"{0.01 * size:.4g}")
        self.loops.append((f"{side}_rod", f"{side}_shin", np.array([0, 0, -0.25 * size])))

    def arm(self, chest: ElementTree.Element, chest_at: FloatArray, side: str) -> None:
        build, size = self.build, self.build.leg
        sign = 1 if side == "left" else -1
        flip = -1 if build.mirrored and side == "right" else 1
        at = chest_at + np.array([0, sign * 0.3 * size, 0.15 * size])
        turns = [(f"{side}_arm", axis, -2.0, 2.0, 0.08) for axis in _ARM[: build.arm]]
        upper = self.chain(chest, chest_at, f"{side}_upper_arm", at, 0.03, turns[:3], flip=flip)
        self.rod(upper, 0.3 * size, 0.05 * size)
        elbow = at - np.array([0, 0, 0.38 * size])
        fore = self.chain(upper, at, f"{side}_forearm", elbow, 0.02, turns[3:5], flip=flip)
        self.rod(fore, 0.3 * size, 0.04 * size)
        end, place = fore, elbow
        if turns[5:]:
            place = elbow - np.array([0, 0, 0.35 * size])
            end = self.chain(fore, elbow, f"{side}_hand", place, 0.008, turns[5:], flip=flip)
            self.rod(end, 0.1 * size, 0.04 * size)
        if build.fingers:
            for name in ("finger", "finger_tip"):
                there = place - np.array([0, 0, 0.15 * size])
                finger = self.body(end, f"{side}_{name}", there, place, 0.001)
                self.joint(finger, f"{side}_{name}", "x", -0.1, 1.2, 0.001 if name == "finger" else None)
                self.rod(finger, 0.05 * size, 0.01 * size)
                end, place = finger, there

    def chain(
        self,
        parent: ElementTree.Element,
        parent_at: FloatArray,
        name: str,
        at: FloatArray,
        share: float,
        turns: Sequence[tuple[str, str, float, float, float]],
        pivot: FloatArray | None = None,
        flip: int = 1,
    ) -> ElementTree.Element:
        """A body on joints that turn in one point, each but the last on a small body of its own where not together."""
        pivot = at if pivot is None else pivot
        where = parent_at
        for i, (joint, axis, low, high, effort) in enumerate(turns):
            last = self.build.together or i == len(turns) - 1
            here = at if last else pivot
            if i == 0 or not self.build.together:
                parent = self.body(parent, name if last else f"{name}_{i}", here, where, share if last else 0.008)
            self.joint(parent, f"{joint}_{axis[-1]}_{self.count}", axis, low, high, effort, pivot - here, flip)
            where = here
        return parent

    def body(
        self, parent: ElementTree.Element, name: str, at: FloatArray, parent_at: FloatArray, share: float
    ) -> ElementTree.Element:
        build = self.build
        found = ElementTree.SubElement(parent, "body", pos=_text(at - parent_at))
        if build.named:
            found.set("name", name)
        mass = share * build.mass
        spread = 0.35 * build.leg * share ** (1 / 3)
        rough = 1 + build.uneven * self.random.uniform(-1, 1, 3)
        inertia = mass * spread**2 * np.maximum(rough, 0.7)
        middle = build.uneven * spread * self.random.uniform(-1, 1, 3)
        down = np.array([0, 0, -0.4 * spread]) if "pelvis" not in name and "chest" not in name else np.zeros(3)
        ElementTree.SubElement(
            found, "inertial", mass=f"{mass * rough[0]:.6g}", pos=_text(middle + down), diaginertia=_text(inertia)
        )
        return found

    def joint(
        self,
        body: ElementTree.Element,
        name: str,
        axis: str,
        low: float,
        high: float,
        effort: float | None,
        at: Point = (0.0, 0.0, 0.0),
        flip: int = 1,
    ) -> ElementTree.Element:
        """A hinge; nothing drives it where its effort, of weight times leg, is None."""
        self.count += 1
        if flip < 0:
            low, high = -high, -low
        unit = 180 / np.pi if self.build.degrees else 1.0
        vector = np.multiply(_AXES[axis[-1]], flip * (-1 if axis[0] == "-" else 1))
        found = ElementTree.Element("joint", axis=_text(vector), pos=_text(at), range=_text([low * unit, high * unit]))
        if self.build.named:
            found.set("name", name)
        body.append(found)
        if effort is not None and self.build.named:  # actuators go by names
            self.driven.append((name, effort * self.build.mass * 9.81 * self.build.leg))
        return found

    def actuators(self, model: ElementTree.Element) -> None:
        build = self.build
        driven = list(self.driven)
        if build.shuffled:
            self.random.shuffle(driven)
        actuator = ElementTree.SubElement(model, "actuator")
        for name, effort in driven:
            if build.drive == "motor":
                most = effort / build.gear
                ElementTree.SubElement(
                    actuator, "motor", joint=name, gear=f"{build.gear:g}", ctrlrange=_text([-most, most])
                )
            else:
                limits = _text([-effort, effort])
                ElementTree.SubElement(actuator, "position", joint=name, kp=f"{effort:.4g}", forcerange=limits)

    def sole(self, foot: ElementTree.Element) -> None:
        build, size = self.build, self.build.leg
        heel, toe, half = build.heel_toe_half_width
        low = -0.1 * size
        if build.sole == "box":
            middle, extent = [(heel + toe) / 2, 0, low + 0.015 * size], [(toe - heel) / 2, half, 0.015 * size]
            ElementTree.SubElement(foot, "geom", type="box", pos=_text(middle), size=_text(extent))
        elif build.sole == "mesh":
            ElementTree.SubElement(foot, "geom", type="mesh", mesh="foot")
        elif build.sole == "points":
            ball = 0.01 * size
            for x, y in product((heel, toe), (-half, half)):
                ElementTree.SubElement(foot, "geom", type="sphere", pos=_text([x, y, low + ball]), size=f"{ball:g}")
        elif build.sole == "capsules":
            thick = 0.02 * size
            for y in (-half, half):
                ends = _text([heel, y, low + thick, toe, y, low + thick])
                ElementTree.SubElement(foot, "geom", type="capsule", fromto=ends, size=f"{thick:g}")

    def box(self, body: ElementTree.Element, shape: Point) -> None:
        ElementTree.SubElement(body, "geom", type="box", size=_text(np.multiply(shape, self.build.leg)))

    def rod(self, body: ElementTree.Element, length: float, radius: float) -> None:
        ends = _text([0, 0, -radius, 0, 0, -length + radius if length > 2 * radius else -1.1 * radius])
        ElementTree.SubElement(body, "geom", type="capsule", fromto=ends, size=f"{radius:.4g}")


def _text(values: Iterable[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)
