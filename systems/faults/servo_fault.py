"""What the faults of the servo share: a softer one, by the command that has its effect."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from systems.faults.fault import Fault, Setting


class ServoFault(Fault):
    """A servo with less stiffness. Gains are fixed when Drake finalizes a plant: so the command is changed instead.

    With the command q + k (q_d - q) for q_d the servo's torque is k times as large at the same deviation; Drake's
    implicit servo reads q at the end of a step of the plant, so that its damping grows by its stiffness times that
    step.

    Inputs:
        desired_posture: (M,) command, rad and m.
        joint_angles: (J,) as they are, rad, at every step of the plant.
        finger_gap: (M - J,) as measured, m.
    Outputs:
        faulty_desired_posture: (M,) command for the servo. Direct feedthrough.
    """

    acts_on = "servo"
    needs: ClassVar[tuple[str, ...]] = ("joint_angles",)

    def __init__(self, setting: Setting):
        super().__init__(setting)
        size, joints = setting.posture_size, setting.joints
        self._desired = self.DeclareVectorInputPort("desired_posture", size)
        self._angles = self.DeclareVectorInputPort("joint_angles", joints)
        self._gap = self.DeclareVectorInputPort("finger_gap", size - joints)
        reads = {self.all_input_ports_ticket(), self.all_parameters_ticket(), self.all_state_ticket()}
        self.DeclareVectorOutputPort("faulty_desired_posture", size, self._calc_command, reads)

    @abstractmethod
    def _stiffness(self, context: Context, severity: float) -> np.ndarray:
        """k, (M,): what is left of each component's stiffness, 0 to 1."""

    def _calc_command(self, context: Context, output: BasicVector) -> None:
        desired, severity = self._desired.Eval(context), self._strength(context)
        if severity:
            measured = np.concatenate((self._angles.Eval(context), self._gap.Eval(context)))
            desired = measured + self._stiffness(context, severity) * (desired - measured)
        output.SetFromVector(desired)
