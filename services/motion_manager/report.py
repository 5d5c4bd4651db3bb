"""What a Motion Manager did in a period, and what it believes: its MotionState."""

from __future__ import annotations

import numpy as np

from valor.common.behaviors import Manipulation
from valor.common.messages import MotionState
from valor.motion_manager.parts import Parts
from valor.whole_body.state import QpStatus

_ZEROS = np.zeros(6)


class Reporter:
    """Gathers it from those who know."""

    def __init__(self, parts: Parts) -> None:
        self._parts = parts

    def report(self, proprioceptor_sequence: int, *, motor_time: float, tick_time: float) -> MotionState:
        """The period's.

        Args:
            proprioceptor_sequence: of the newest.
            motor_time: as ``MotionState`` has it [s].
            tick_time: likewise [s].
        """
        parts, state, command = self._parts, self._parts.state, self._parts.balance.command
        fsm, pelvis, motors = parts.fsm, parts.controller.pelvis, parts.command
        # While nobody wants the DCM anywhere its reference is where it is.
        dcm_reference = state.dcm_in_odom if state else _ZEROS[:3]
        if command is not None:
            dcm_reference = command.dcm_reference_in_odom
        return MotionState(
            time=parts.time,
            proprioceptor_sequence=proprioceptor_sequence,
            behavior=fsm.behavior,
            locomotion=fsm.locomotion,
            manipulation=fsm.manipulation,
            attention=fsm.attention,
            reason=fsm.reason,
            pelvis_position_in_odom=state.pelvis_position_in_odom if state else _ZEROS[:3],
            pelvis_orientation_in_odom=state.pelvis_orientation_in_odom if state else np.eye(4)[0],
            pelvis_linear_velocity_in_odom=state.pelvis_linear_velocity_in_odom if state else _ZEROS[:3],
            pelvis_angular_velocity_in_pelvis=state.pelvis_angular_velocity_in_pelvis if state else _ZEROS[:3],
            com_in_odom=state.com_in_odom if state else _ZEROS[:3],
            dcm_in_odom=state.dcm_in_odom if state else _ZEROS[:3],
            dcm_reference_in_odom=dcm_reference,
            cop_in_odom=state.cop_in_odom if state else np.full(2, np.nan),
            contacts=state.contacts if state else np.zeros(2, dtype=np.uint8),
            contact_probability=state.contact_probability if state else _ZEROS[:2],
            pelvis_position_variance=state.pelvis_position_variance if state else _ZEROS[:3],
            pelvis_orientation_variance=state.pelvis_orientation_variance if state else _ZEROS[:3],
            pelvis_linear_velocity_variance=state.pelvis_linear_velocity_variance if state else _ZEROS[:3],
            hand_contacts=parts.hand_contacts.contacts,
            left_arm=self._led_by(0),
            right_arm=self._led_by(1),
            joint_setpoint=motors.position,
            pelvis_setpoint=pelvis.position,
            pelvis_in_support=pelvis.measured(state) if state else _ZEROS,
            desired_foot_forces=command.desired_foot_forces if command else _ZEROS[:2],
            qp_status=int(command.qp_status if command else QpStatus.NOT_RUN),
            qp_failures=parts.controller.qp_failures,
            torque_saturations=motors.saturations,
            motor_time=motor_time,
            tick_time=tick_time,
        )

    def _led_by(self, side: int) -> str:
        """Who leads an arm from outside (0 left, 1 right)."""
        if self._parts.fsm.manipulation is not Manipulation.TELEOP:
            return "nobody"
        return "hand_goal" if self._parts.hand_goals.leads(side) else "setpoints"
