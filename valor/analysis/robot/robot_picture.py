"""A robot on one page: exterior, interior, and ranges of its joints."""

from contextlib import closing
from pathlib import Path

import mujoco
import numpy as np
from matplotlib.axes import Axes

from valor.analysis import style
from valor.common.arrays import FloatArray
from valor.common.errors import ValorError
from valor.drawing import Posture
from valor.drawing.offscreen import Image
from valor.drawing.scene import Scene
from valor.robot.description import RobotDescription
from valor.robot.model import Model, full_model
from valor.robot.tables import SIDES

COLORS = {"x": "#d55e00", "y": "#009e73", "z": "#0072b2"}  # of joint axes, by their direction in this posture
COM, SOLE, SHAPE = "#e69f00", "#cc79a7", "#56b4e9"
_DPI = 110
_PANEL = (520, 930)  # of one view [pixels]
_LIMITS = 7.2  # width of the plots next to the views [inches]
_HEADER = 0.75  # [inches]
_SEEN = 0.13  # opacity of the exterior in the view of the interior
_VIEW = np.tan(np.deg2rad(45.0 / 2))  # half the height of MuJoCo's view, per distance
_WHOLE_TURN = 2 * np.pi  # drawn range of a joint without limits [rad]


def draw(robot: RobotDescription, file: Path) -> Path:
    """Write the page as a PNG; returns its path. Raises RenderingError (no OpenGL) or ValorError (no file)."""
    model = full_model(robot, "all")
    data = mujoco.MjData(model.mj)
    data.qpos[:] = model.nominal_qpos()
    mujoco.mj_forward(model.mj, data)
    size, aside = _extent(model.mj, data)
    (width, height), total = (side / _DPI for side in _PANEL), 2 * _PANEL[0] / _DPI + _LIMITS
    figure = style.figure(total, height + _HEADER, _DPI)
    views = (_view(robot, model, data, (size, aside), inside) for inside in (False, True))
    for column, image in enumerate(views):
        figure.figimage(image, xo=column * _PANEL[0], yo=0, origin="upper")
    style.heading(
        figure,
        robot.name,
        f"{len(robot.joints)} joints, {model.mj.body_mass.sum():.1f} kg; {size:.2f} m high, "
        f"its CoM {data.subtree_com[1][2]:.2f} m",
    )
    marks = [style.sample(f"joint about {axis}", color, 3.0) for axis, color in COLORS.items()]
    marks += [style.sample(name, color, 6.0) for name, color in (("sole", SOLE), ("collisions", SHAPE), ("CoM", COM))]
    top = 1.0 - 0.30 / (height + _HEADER)
    style.legend(figure, marks, loc="center left", bbox_to_anchor=(1.14 * width / total, top), ncols=3)
    left, right = (2 * width + 1.75) / total, 1.0 - 1.45 / total
    _limits(figure.add_axes((left, 0.07, right - left, 0.87)), robot)
    try:
        return style.save(figure, file, _DPI)
    except (OSError, ValueError) as error:
        raise ValorError(f"{file}: the picture cannot be written: {' '.join(str(error).split())}") from None


def _extent(mj: mujoco.MjModel, data: mujoco.MjData) -> tuple[float, float]:
    """Height of the highest geometry, and its largest lateral distance from the CoM [m]."""
    rotations = data.geom_xmat.reshape(-1, 3, 3)
    centres = data.geom_xpos + np.einsum("gij,gj->gi", rotations, mj.geom_aabb[:, :3])
    reach = np.einsum("gij,gj->gi", np.abs(rotations), mj.geom_aabb[:, 3:])
    aside = np.abs(centres[:, 1] - data.subtree_com[1][1]) + reach[:, 1]
    return float((centres[:, 2] + reach[:, 2]).max()), float(aside.max())


def _view(
    robot: RobotDescription, model: Model, data: mujoco.MjData, extent: tuple[float, float], inside: bool
) -> Image:
    """Draw the exterior from the front and one side, or the interior from the front and the other side."""
    size, aside = extent
    posture = Posture(0.0, "", data.qpos[:3].copy(), data.qpos[3:7].copy(), robot.nominal_posture)

    def add(spec: mujoco.MjSpec) -> None:
        _add_com(spec, data.subtree_com[1], size)
        if inside:
            _see_through(spec, model)
            _add_axes(spec, model, data, size)
            _add_soles(spec, robot, model, size)

    with closing(Scene(robot, *_PANEL, add=add)) as scene:
        middle = np.array([*data.subtree_com[1][:2], 0.49 * size])
        scene.look_at(
            middle, 205.0 if inside else 148.0, -8.0, max(0.60 * size, 1.4 * aside * _PANEL[1] / _PANEL[0]) / _VIEW
        )
        return scene.draw(posture)


def _rgba(color: str, alpha: float = 1.0) -> tuple[float, float, float, float]:
    red, green, blue = (int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue, alpha


def _add_com(spec: mujoco.MjSpec, com: FloatArray, size: float) -> None:
    """Add a ball at the CoM, its plumb line, and their point on the ground."""
    seen = {"contype": 0, "conaffinity": 0, "rgba": _rgba(COM)}
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.016 * size, 0, 0], pos=com, **seen)
    cylinder = mujoco.mjtGeom.mjGEOM_CYLINDER
    spec.worldbody.add_geom(type=cylinder, size=[0.002 * size, 0, 0], fromto=[*com, *com[:2], 0.0], **seen)
    disc = [0.014 * size, 0.002 * size, 0]
    spec.worldbody.add_geom(type=cylinder, size=disc, pos=[*com[:2], 0.002 * size], **seen)


def _see_through(spec: mujoco.MjSpec, model: Model) -> None:
    """Make the exterior transparent and show collision shapes."""
    own = {model.mj.body(i).name for i in range(1, model.mj.nbody)}
    for geom in spec.geoms:
        if geom.parent.name not in own:
            continue
        if geom.contype or geom.conaffinity:
            geom.group, geom.material, geom.rgba = 0, "", _rgba(SHAPE, 0.17)
        else:
            geom.material, geom.rgba = "", (*geom.rgba[:3], _SEEN)


def _add_axes(spec: mujoco.MjSpec, model: Model, data: mujoco.MjData, size: float) -> None:
    """Add a rod along each joint's axis, with a ball at its positive end."""
    for name in model.joints:
        joint, axis = model.mj.joint(name), np.abs(data.joint(name).xaxis)
        look = {"contype": 0, "conaffinity": 0, "rgba": _rgba(COLORS["xyz"[int(np.argmax(axis))]])}
        reach = 0.028 * size * joint.axis / np.linalg.norm(joint.axis)
        body = spec.body(model.mj.body(joint.bodyid[0]).name)
        ends = [*(joint.pos - reach), *(joint.pos + reach)]
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.0042 * size, 0, 0], fromto=ends, **look)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.0075 * size, 0, 0], pos=ends[3:], **look)


def _add_soles(spec: mujoco.MjSpec, robot: RobotDescription, model: Model, size: float) -> None:
    for side in SIDES:
        foot = getattr(robot.tables.feet, side)
        site = model.mj.site(foot.sole)
        middle, turned = np.array([(foot.heel + foot.toe) / 2, 0.0, 0.0]), np.zeros(3)
        mujoco.mju_rotVecQuat(turned, middle, site.quat)
        spec.body(model.mj.body(site.bodyid[0]).name).add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[(foot.toe - foot.heel) / 2, foot.half_width, 0.005 * size],
            pos=site.pos + turned,
            quat=site.quat,
            contype=0,
            conaffinity=0,
            rgba=_rgba(SOLE),
        )


def _limits(axes: Axes, robot: RobotDescription) -> None:
    """Draw a bar per joint from limit to limit, with nominal posture, effort and velocity."""
    style.quiet(axes, "Limits, and the nominal posture", "[rad]")
    rows = [(group, joint) for group, joints in robot.tables.groups.items() for joint in joints]
    names = [joint for _, joint in rows]
    numbers = robot.tables.joints
    for row, (group, name) in enumerate(rows):
        joint, color = numbers[name], style.SERIES[list(robot.tables.groups).index(group) % len(style.SERIES)]
        lower = -_WHOLE_TURN if joint.lower is None else joint.lower
        upper = _WHOLE_TURN if joint.upper is None else joint.upper
        axes.barh(row, upper - lower, left=lower, height=0.56, color=color, alpha=0.12 if joint.lower is None else 0.38)
        nominal = robot.tables.nominal_posture.get(name, 0.0)
        axes.plot(nominal, row, "o", color=color, markersize=4.5)
        text = f"{joint.effort:.4g} N·m  {joint.velocity:.3g} rad/s"
        axes.text(1.02, row, text, transform=axes.get_yaxis_transform(), fontsize=7, color=style.GREY, va="center")
    axes.axvline(0.0, color=style.GREY, linewidth=0.8)
    axes.set_yticks(range(len(names)), names, fontsize=min(8.0, 270.0 / len(names)))
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(False, axis="y")
