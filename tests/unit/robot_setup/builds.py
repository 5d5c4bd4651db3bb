"""Generated robots that cover the variety of makers' models, and folders created from them."""

from __future__ import annotations

from pathlib import Path

from harness.generated_robot import Build, mjcf
from valor.robot.description import RobotDescription
from valor.robot_setup.new import new_robot

BUILDS = {
    "plain": Build(),
    "3 kg on points": Build(mass=3, leg=0.22, sole="points"),
    "180 kg, waist of three, fingers, a spring": Build(
        mass=180, leg=1.0, waist="zyx", arm=7, fingers=True, spring=True, degrees=True, uneven=0.1
    ),
    "chest root, negative knees, mirrored, geared, shuffled": Build(
        root="chest", waist="zy", hip="yxz", knee=-1, mirrored=True, gear=50, shuffled=True, floor=True
    ),
    "no waist, mesh soles, servos, a keyframe": Build(
        waist="", hip="xzy", arm=5, drive="position", sole="mesh", keyframe=True
    ),
    "no names, no actuators, capsules": Build(named=False, drive="none", sole="capsules", arm=6),
    "fixed in the world": Build(floating=False, hip="yzx", waist="xyz", root="chest", sensors=True, drive="none"),
    "several joints a body": Build(together=True, waist="zyx", arm=7, root="chest", hip="xyz"),
    "along y": Build(heading=1.5708),
    "backwards": Build(heading=3.14159, root="chest", hip="xyz", knee=-1),
    "sprung toes, rods in loops, coupled fingers": Build(
        toes=True, linkage=True, fingers=True, arm=7, spring=True, uneven=0.05, root="chest"
    ),
    "neither arms nor head": Build(arm=0, neck=False, waist=""),
}


def written(build: Build, folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "maker.xml"
    file.write_text(mjcf(build))
    return file


def made(build: Build, folder: Path) -> RobotDescription:
    new_robot(written(build, folder), folder / "robot", "generated")
    return RobotDescription.load(folder / "robot")
