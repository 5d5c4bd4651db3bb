"""What a Motion Manager did in a period, and what it believes: its MotionState."""

from __future__ import annotations

import numpy as np

from valor.common.behaviors import Manipulation
from valor.common.messages import MotionState
from valor.motion_manager.hands.hand_contact import HandContacts
from valor.motion_manager.hands.hand_goals import HandGoals
from valor.motion_manager.joints.command import MotorCommand
from valor.motion_manager.states.behavior_fsm import BehaviorFsm
from valor.motion_manager.whole_body import QpStatus, RobotState, WholeBodyCommand, WholeBodyController

_ZEROS = np.zeros(6)


class Reporter:
    """Gathers it from those who know."""

    def __init__(
        self,
        fsm: BehaviorFsm,
        command: MotorCommand,
        controller: WholeBodyController,
        hand_goals: HandGoals,
        hand_contacts: HandContacts,
    ) -> None:
        self._fsm = fsm
        self._command = command
        self._controller = controller
        self._hand_goals = hand_goals
        self._hand_contacts = hand_contacts

    def report(
        self,
        time: int,
        proprioceptor_sequence: int,
        state: RobotState | None,
        command: WholeBodyCommand | None,
        *,
        motor_time: float,
        tick_time: float,
    ) -> MotionState:
        """The period's.

        Args:
            time: robot time [ns].
            proprioceptor_sequence: of the newest.
            state: of the robot; None: it is not known yet.
            command: of the Whole-Body Controller; None: it has not the legs.
            motor_time: as ``MotionState`` has it [s].
            tick_time: likewise [s].
        """
        fsm = self._fsm
        # While nobody wants the DCM anywhere its reference is where it is.
        dcm_reference = state.dcm_in_odom if state else _ZEROS[:3]
        if command is not None:
            dcm_reference = command.dcm_reference_in_odom
        return MotionState(
            time=time,
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
            hand_contacts=self._hand_contacts.contacts,
            left_arm=self._led_by(0),
            right_arm=self._led_by(1),
            joint_setpoint=self._command.position,
            pelvis_setpoint=self._controller.pelvis.position,
            pelvis_in_support=self._controller.pelvis.measured(state) if state else _ZEROS,
            desired_foot_forces=command.desired_foot_forces if command else _ZEROS[:2],
            qp_status=int(command.qp_status if command else QpStatus.NOT_RUN),
            qp_failures=self._controller.qp_failures,
            torque_saturations=self._command.saturations,
            motor_time=motor_time,
            tick_time=tick_time,
        )

    def _led_by(self, side: int) -> str:
        """Who leads an arm from outside (0 left, 1 right)."""
        if self._fsm.manipulation is not Manipulation.TELEOP:
            return "nobody"
        return "hand_goal" if self._hand_goals.leads(side) else "setpoints"
