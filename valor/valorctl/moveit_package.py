"""A robot's configuration for MoveIt, in a package that is there as a whole or not at all."""

from __future__ import annotations

from pathlib import Path

from valor.common.instance import ros_namespace
from valor.robot.description import RobotDescription
from valor.valorctl import whole_folder
from valor.valorctl.console import progress, say, say_rows
from valor.valorctl.interruption import Interruption


def make(robot: RobotDescription, out: Path | None, *, namespace: str, replace: bool) -> None:
    """Write the package, and say what is in it and what comes next.

    Args:
        robot: its description.
        out: the package's folder; None: one of the usual name, here.
        namespace: of the robot, as ``up`` takes it; empty: none.
        replace: whether a configuration that is there makes way.

    Raises:
        ConfigurationError: the robot's model cannot be read, the folder is in the way or cannot be written, its name
            is none for a package, or the namespace none of ROS.
    """
    from valor.moveit import collisions, package

    namespace = ros_namespace(namespace)
    folder = (out or Path(package.usual_name(robot, namespace))).expanduser()
    package.require_name(folder.name)
    whole_folder.require_free(folder, package.MARK, "configurations of MoveIt", replace)
    with progress() as shown, Interruption() as interruption, whole_folder.beside(folder) as draft:
        made = package.write(robot, draft, shown.stage, collisions.SAMPLES, namespace=namespace)
        interruption.check()
        whole_folder.put(draft, folder)
    chains = [limb.name for limb in made.groups.values() if limb.tip]
    others = [limb.name for limb in made.groups.values() if not limb.tip]
    say_rows(
        [
            ("robot", f"{robot.name}: {len(robot.joints)} joints"),
            ("namespace", namespace or "none"),
            ("chains", ", ".join(chains)),
            ("other groups", ", ".join(others) or "none"),
            ("pairs of links", f"{made.pairs - made.disabled} of {made.pairs} looked at"),
            ("meshes", str(made.meshes)),
        ]
    )
    say(f"\n{folder}: a ROS package. Next, in a workspace's src, where MoveIt is:")
    say(f"  colcon build --packages-select {folder.name}")
    say(f"  ros2 launch {folder.name} move_group.launch.py")
