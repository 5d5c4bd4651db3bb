"""The page behind the link: ages are the link's, not those of what comes by; what the link says is shown."""

import io

import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from PIL import Image
from sensor_msgs.msg import CompressedImage, JointState
from vigir_humanoid_control_msgs.msg import ControlModeStatus
from viser import ViserServer

from valor.common.linking import PICTURE
from valor.operator_station.robot.intake import Intake
from valor.operator_station.tabs.status import NONE_THROUGH_LINK, View


def say(intake: Intake, topic: str, message: object, now: float) -> None:
    next(each for each in intake.inputs if each.topic == topic).take(message, now)


def status(**values: str) -> DiagnosticStatus:
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(message="the robot is heard", values=pairs)


def test_what_comes_is_as_old_as_the_link_says() -> None:
    intake = Intake(linked=True)
    say(intake, "joint_states", JointState(name=["knee"], position=[0.5]), 10.0)
    assert intake.heard.joints == {"knee": 0.5}
    assert intake.heard.ages.text("joints", 10.0) == "never heard", "nobody has said how old it is"
    say(intake, "link/status", status(state_age="0.300", mode_age="2.500", behavior_age="inf"), 10.0)
    ages = intake.heard.ages
    assert abs(ages.age("joints", 10.0) - 0.3) < 1e-9 and abs(ages.age("mode", 11.0) - 3.5) < 1e-9
    say(intake, "flor/controller/mode", ControlModeStatus(current_control_mode="stand"), 12.0)
    assert intake.heard.mode.current == "stand" and abs(ages.age("mode", 12.0) - 4.5) < 1e-9
    assert ages.text("motion", 12.0) == "never heard"
    assert all(each.topic != "link/status" for each in Intake().inputs)


@pytest.mark.parametrize(("linked", "name", "bound"), [
    (False, "joints", 0.5), (False, "mode", 1.5), (True, "joints", 1.5), (True, "mode", 2.5),
])  # fmt: skip
def test_behind_the_link_values_are_grey_later(linked: bool, name: str, bound: float) -> None:
    intake = Intake(linked=linked)
    if linked:
        say(intake, "link/status", status(state_age="0", mode_age="0"), 0.0)
    else:
        say(intake, "joint_states", JointState(), 0.0)
        say(intake, "flor/controller/mode", ControlModeStatus(), 0.0)
    ages = intake.heard.ages
    assert not ages.old(name, bound - 0.01) and ages.text(name, bound - 0.01) == "fresh"
    assert ages.old(name, bound + 0.01) and ages.text(name, bound + 0.01) == f"{bound:.1f} s old"


def test_the_page_says_what_a_lost_operator_means_and_what_became_of_commands() -> None:
    intake = Intake(linked=True)
    values = {"state_age": "0.3", "fast_channel": "false", "last_command": "goal_pose: done, 1 s ago"}
    say(intake, "link/status", status(when_lost="go_on", lost_after="10", **values), 0.0)
    assert intake.heard.link is not None
    state, lost, command = intake.heard.link.lines()
    assert "the robot is heard" in state and "0.3 s old" in state and "closed" in state
    assert "goes on to its end" in lost and "goal_pose: done" in command
    say(intake, "link/status", status(when_lost="stop", lost_after="7", **values), 0.0)
    assert "stopped 7 s after" in intake.heard.link.lines()[1]


def test_a_picture_is_shown_with_the_age_that_the_link_tells() -> None:
    server = ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        view, intake = View(server, server.gui.add_panel().add_tab("Robot"), linked=True), Intake(linked=True)
        view.draw(intake.heard, 0.0)
        assert view._text.content == NONE_THROUGH_LINK and view._image is None
        say(intake, PICTURE, CompressedImage(format="jpeg", data=b"no picture at all"), 0.0)
        view.draw(intake.heard, 0.0)
        assert view._image is None, "what is no picture is not shown"
        content = io.BytesIO()
        Image.new("RGB", (1280, 960), (200, 30, 30)).save(content, "jpeg")
        say(intake, PICTURE, CompressedImage(format="jpeg", data=content.getvalue()), 1.0)
        say(intake, "link/status", status(picture_age="7.000"), 1.0)
        view.draw(intake.heard, 3.0)
        assert view._image is not None and view._image.image.shape == (480, 640, 3)
        assert view._text.content == "The picture is 9.0 s old."
    finally:
        server.stop()
