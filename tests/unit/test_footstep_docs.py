"""docs/interfaces.md states of every field of a step plan, its feedback and its result what becomes of it."""

import re

import pytest
from vigir_footstep_planning_msgs.action import ExecuteStepPlan
from vigir_footstep_planning_msgs.msg import Feet, Foot, Step, StepPlan, StepPlanFeedback

from harness.places import REPOSITORY

TYPES = {
    "StepPlan": StepPlan, "Feet": Feet, "Foot": Foot, "Step": Step, "Result": ExecuteStepPlan.Result,
    "Feedback": ExecuteStepPlan.Feedback, "StepPlanFeedback": StepPlanFeedback,
}  # fmt: skip


@pytest.mark.parametrize("name", TYPES)
def test_every_field_is_in_the_table_and_no_other(name: str) -> None:
    text = (REPOSITORY / "docs" / "interfaces.md").read_text()
    said = set(re.findall(rf"`{name}\.(\w+)`", text))
    assert said == set(TYPES[name].get_fields_and_field_types())
