"""The second cheapest baseline: how much does the arm turn back on itself?"""

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from systems.arguments import require_count
from systems.detector import CalibratedDetector


@TemplateSystem.define("ReversalsDetector_", T_list=[float, AutoDiffXd])
def ReversalsDetector_(T):
    class Impl(CalibratedDetector, LeafSystem_[T]):
        """l = sum_i max(0, -d_i . d_{i-1}), d_i = m_i - m_{i-1}, over the N + 2 last postures: rad^2.

        Reversals of direction tell dithering and being pushed back from going on. Their count would be 0 in most
        windows and full of a resting arm's noise; here each weighs by what the two steps have against each other.

        .. pydrake_system::

            name: ReversalsDetector
            input_ports: [posture_history, recalled_postures, hidden_state]
            output_ports: [errors, alpha]

        Ports: see systems/detector.py; errors (1,): l / mean_l. Direct feedthrough of `posture_history`; no state;
        converts to AutoDiffXd.

        Constructor: policy, any object with `posture_size`, `horizon`, `state_size` and `scaling`; joints (J), the
        first J components are judged.
        """

        name = "reversals"
        learns_from = "nothing"

        def _construct(self, policy, joints: int, converter=None):
            LeafSystem_[T].__init__(self, converter=converter)
            self.declare_ports(policy, criteria=1, reads=("posture_history",), scalar=T)
            self._policy, self._joints = policy, require_count("joints", joints, maximum=policy.posture_size)
            self._range = policy.scaling.half_range[:joints]

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, other._policy, other._joints, converter=converter)

        @staticmethod
        def build(policy, joints, arrays):
            """Returns the detector for `policy`; nothing was fitted, `arrays` is empty."""
            return ReversalsDetector(policy, joints)

        def calc_errors(self, context, mean_errors):
            rows = self.posture_history.Eval(context).reshape(-1, self._policy.posture_size)[:, : self._joints]
            steps = (rows[:-1] - rows[1:]) * self._range
            against = -(steps[:-1] * steps[1:]).sum(axis=1)
            return np.array([np.where(against > 0.0, against, 0.0 * against).sum()]) / mean_errors

    return Impl


ReversalsDetector = ReversalsDetector_[None]
