"""The configuration as an ament package: put into a workspace's ``src`` it is built and launched as any other.

What belongs to MoveIt has the names and places at which ``moveit_configs_utils`` looks for it.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

import yaml

from valor.common.errors import ConfigurationError
from valor.common.instance import frame_prefix
from valor.moveit import parameters
from valor.moveit.collisions import Collisions, disabled_collisions
from valor.moveit.frames import prefixed
from valor.moveit.groups import Group, groups
from valor.moveit.srdf import ODOM, srdf
from valor.robot.description import RobotDescription
from valor.robot.model_tree import read

MARK = ".setup_assistant"
"""A file that every configuration has, and by which one is known."""

_TEMPLATES = Path(__file__).parent / "templates"
_NAME = re.compile(r"[a-z](?:_?[a-z0-9])*")  # of ROS packages, by REP 144
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Configuration:
    """What was made.

    Attributes:
        groups: of joints.
        pairs: of links with shapes.
        disabled: of these, that planners do not look at.
        meshes: files.
    """

    groups: dict[str, Group]
    pairs: int
    disabled: int
    meshes: int


def usual_name(robot: RobotDescription, namespace: str = "") -> str:
    """Of a robot's package, where nobody wants another; of one in a namespace by that."""
    return re.sub(r"[^a-z0-9]+", "_", (namespace or robot.name).lower()).strip("_") + "_moveit_config"


def require_name(name: str) -> None:
    """Raises ``ConfigurationError`` if a package cannot be called so."""
    if not _NAME.fullmatch(name):
        what = "expected lower-case letters, digits and single underscores, a letter first"
        raise ConfigurationError(f"package {name!r}: {what}: ROS looks for packages by such names")


def write(robot: RobotDescription, folder: Path, tell: Tell, samples: int, *, namespace: str = "") -> Configuration:
    """Write the package.

    Args:
        robot: its description.
        folder: an empty one; its name is the package's.
        tell: what is being done.
        samples: random configurations in which links are looked for that never touch.
        namespace: in which the robot's nodes are, and by which its frames are prefixed; empty: none.

    Raises:
        ConfigurationError: the robot's model cannot be read, or the folder's name is none for a package.
        OSError: it cannot be written.
    """
    package = folder.name
    require_name(package)
    tell("reading the model")
    meshes = _Meshes(f"package://{package}/meshes/")
    tree = read(robot, meshes.uri)
    limbs = groups(robot, tree)
    collisions = Collisions(robot)
    tell(f"trying {samples} configurations for links that touch")
    disabled = disabled_collisions(collisions, samples)
    tell(f"writing {package}")
    config = folder / "config"
    config.mkdir()
    prefix = frame_prefix(namespace)
    semantic = srdf(robot, tree.base_frame, limbs, collisions, disabled)
    for kind, description in (("urdf", tree.urdf), ("srdf", semantic)):
        (config / f"{robot.name}.{kind}").write_text(prefixed(description, prefix), encoding="utf-8")
    tables: dict[str, dict[str, Any]] = {
        "joint_limits": parameters.joint_limits(robot),
        "kinematics": parameters.kinematics(limbs),
        "moveit_controllers": parameters.controllers(limbs),
        "pilz_cartesian_limits": parameters.cartesian_limits(robot),
    }
    for name, table in tables.items():
        (config / f"{name}.yaml").write_text(yaml.safe_dump(table, sort_keys=False), encoding="utf-8")
    meshes.copy(folder / "meshes")
    _fill(folder, package=package, robot=robot.name, frame=prefix + ODOM, namespace=namespace and f"/{namespace}")
    links = len(collisions.links)
    return Configuration(limbs, links * (links - 1) // 2, len(disabled), len(meshes.files))


class _Meshes:
    """Files that the URDF names, each under a name of its own in the package."""

    def __init__(self, prefix: str) -> None:
        self._prefix = prefix
        self.files = dict[Path, str]()

    def uri(self, file: Path) -> str:
        """Of a file that the package will have."""
        if file not in self.files:
            name = re.sub(r"[^\w.-]", "_", file.name)
            taken = set(self.files.values())
            while name in taken:
                name = f"_{name}"
            self.files[file] = name
        return self._prefix + self.files[file]

    def copy(self, folder: Path) -> None:
        """Put them there, if there are any."""
        if self.files:
            folder.mkdir()
        for file, name in self.files.items():
            shutil.copyfile(file, folder / name)


def _fill(folder: Path, **values: str) -> None:
    """What every package has, with names in it."""
    for template in sorted(_TEMPLATES.rglob("*.in")):
        file = folder / template.relative_to(_TEMPLATES).with_suffix("")
        if file.name == MARK[1:]:
            file = file.with_name(MARK)
        file.parent.mkdir(exist_ok=True)
        file.write_text(Template(template.read_text(encoding="utf-8")).substitute(values), encoding="utf-8")
