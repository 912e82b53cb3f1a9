"""What the faults of the joints' sensors share: a measured posture in, another one out."""

from abc import abstractmethod

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from systems.faults.fault import Fault, Setting


class PostureFault(Fault):
    """Input `posture` (M,) as it is, output `faulty_posture` (M,) as the controller is told it; rad and m.

    Direct feedthrough. The servo has sensors of its own, which are right.
    """

    acts_on = "measured posture"

    def __init__(self, setting: Setting):
        super().__init__(setting)
        self._posture = self.DeclareVectorInputPort("posture", setting.posture_size)
        reads = {self.all_input_ports_ticket(), self.all_parameters_ticket(), self.all_state_ticket()}
        self.DeclareVectorOutputPort("faulty_posture", setting.posture_size, self._calc_posture, reads)

    @abstractmethod
    def _altered(self, context: Context, posture: np.ndarray, severity: float) -> np.ndarray:
        """What becomes of `posture` (M,), a copy."""

    def _joint(self, context: Context) -> int:
        """The joint that the seed chooses."""
        return int(self._chance(context).integers(self._setting.joints))

    def _calc_posture(self, context: Context, output: BasicVector) -> None:
        posture, severity = self._posture.Eval(context), self._strength(context)
        output.SetFromVector(self._altered(context, posture.copy(), severity) if severity else posture)
