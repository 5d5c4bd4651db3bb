"""``get_up_plan.yaml``: on what a robot stands in each key pose of its way up, and what it is to look like."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from valor.common.table import NonNegative, Positive, Table

FILE = "get_up_plan.yaml"  # in the robot's folder
Range = Annotated[list[float], Meta(min_length=2, max_length=2)]


class ContactPoints(Table, kw_only=True):
    """Where a body of the left side or the middle touches the floor; that of the right side mirrors it."""

    body: str
    points: list[Annotated[list[float], Meta(min_length=3, max_length=3)]]  # in its frame [m]
    radius: NonNegative = 0.0  # of the shape around them [m]
    friction: Positive


class PlannedPose(Table, kw_only=True):
    """One key pose. Angles of the left side and the middle [rad]; the right side mirrors them."""

    name: str
    duration: Positive  # of the way there [s]
    hold: NonNegative = 0.0  # then [s]
    pitch: Range  # of the pelvis afterwards, from and to [deg]
    near: dict[str, float] = {}  # where joints had best be; those not named: as in the pose before  # noqa: RUF012
    loaded: list[str] = []  # contacts that carry; empty: the robot lies, and `near` is the pose  # noqa: RUF012
    touching: list[str] = []  # further contacts on the floor, without load  # noqa: RUF012
    com: Range | None = None  # how far the CoM is ahead of the first point of `com_of`, at least and at most [m]
    com_of: str = ""  # a contact
    balanced: bool = False  # by feedback, on the way there and in the hold; handed on to get_up.yaml


class Balance(Table):
    """Feedback of the balanced poses; handed on to get_up.yaml."""

    joints: list[str]
    gain: Positive  # [rad/m]
    limit: Positive  # [rad]


class GetUpPlan(Table, kw_only=True):
    """``get_up_plan.yaml``."""

    moved: list[str]  # joints that the optimisation moves; the others keep what the poses say
    roll: Positive  # of the pelvis, at most [deg]; handed on to get_up.yaml
    balance: Balance
    torque: Annotated[float, Meta(gt=0, le=1)]  # share of the joints' limits
    margin: NonNegative  # to the joints' limits [rad]
    contacts: dict[str, ContactPoints]
    face_down: Annotated[list[PlannedPose], Meta(min_length=1)]
