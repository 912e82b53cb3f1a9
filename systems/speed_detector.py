"""The cheapest baseline: how fast are the joints?"""

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from systems.arguments import require_count
from systems.detector import CalibratedDetector, period_of


@TemplateSystem.define("SpeedDetector_", T_list=[float, AutoDiffXd])
def SpeedDetector_(T):
    class Impl(CalibratedDetector, LeafSystem_[T]):
        """l = sum_j ((m_kj - m_{k-1,j}) / T)^2 over the joints: the square of their speed, (rad/s)^2.

        A size of the motion is what every comparison of monitors should beat (as the magnitude of the action chunks in
        ActProbe, arXiv:2606.08508, 2026). A steady stop has none.

        .. pydrake_system::

            name: SpeedDetector
            input_ports: [posture_history, recalled_postures, hidden_state]
            output_ports: [errors, alpha]

        Ports: see systems/detector.py; errors (1,): l / mean_l. Direct feedthrough of `posture_history`; no state;
        converts to AutoDiffXd.

        Constructor: policy, any object with `posture_size`, `horizon`, `state_size` and `scaling`; joints (J), the
        first J components are judged.
        """

        name = "speed"
        learns_from = "nothing"

        def _construct(self, policy, joints: int, converter=None):
            LeafSystem_[T].__init__(self, converter=converter)
            self.declare_ports(policy, criteria=1, reads=("posture_history",), scalar=T)
            self._policy, self._joints = policy, require_count("joints", joints, maximum=policy.posture_size)
            self._rate = policy.scaling.half_range[:joints] / period_of(policy)  # of a scaled step

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, other._policy, other._joints, converter=converter)

        @staticmethod
        def build(policy, joints, arrays):
            """Returns the detector for `policy`; nothing was fitted, `arrays` is empty."""
            return SpeedDetector(policy, joints)

        def calc_errors(self, context, mean_errors):
            rows = self.posture_history.Eval(context).reshape(-1, self._policy.posture_size)[:2, : self._joints]
            return np.array([np.square((rows[0] - rows[1]) * self._rate).sum()]) / mean_errors

    return Impl


SpeedDetector = SpeedDetector_[None]
