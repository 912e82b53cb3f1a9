"""The paper's detector: does the network recall what the arm did (Eqs. 5 and 6)?"""

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from systems.arguments import require_count
from systems.detector import CalibratedDetector, sizes_of


def joint_weights(posture_size: int, joints: int) -> np.ndarray:
    """(M,) weights of the components in l_n: 1 / J for the first J, the joints; 0 for the fingers.

    Under alpha = 1 the fingers keep their command whatever the network goes through: their recall is not judged.
    """
    weights = np.append(np.ones(joints), np.zeros(posture_size - joints))
    return weights / weights.sum()


def recall_errors(difference: np.ndarray, weights: np.ndarray, reference_errors: np.ndarray) -> np.ndarray:
    """l_n / r_n, (N + 1,), Eq. 5: l_n is the squared error of what is recalled of tick k - n, averaged over the joints.

    Args:
        difference: (N + 1, M) recalled minus measured postures (or the reverse), scaled.
        weights: (M,) of `joint_weights`.
        reference_errors: (N + 1,) r_n, scaled units squared; float or AutoDiffXd, like `difference`.
    """
    return (difference * difference * (weights / reference_errors[:, None])).sum(axis=1)


@TemplateSystem.define("RecallDetector_", T_list=[float, AutoDiffXd])
def RecallDetector_(T):
    class Impl(CalibratedDetector, LeafSystem_[T]):
        """Judges the recall of each of the last N + 1 ticks; row 0 is the prediction that the tick before made for this one.

        .. pydrake_system::

            name: RecallDetector
            input_ports:
            - posture_history
            - recalled_postures
            - hidden_state
            output_ports:
            - errors
            - alpha

        Ports: see systems/detector.py; errors (N + 1,): l_n / r_n, n = 0 .. N. `hidden_state` is left unread.
        Direct feedthrough of both postures; converts to AutoDiffXd.

        Constructor: keywords posture_size (M), horizon (N), state_size (S); joints (J), the first J components are judged.
        """

        name = "recall"

        def _construct(self, *, joints: int, converter=None, **sizes):
            LeafSystem_[T].__init__(self, converter=converter)
            reads = ("posture_history", "recalled_postures")
            self.declare_ports(sizes, criteria=sizes["horizon"] + 1, reads=reads, scalar=T)
            joints = require_count("joints", joints, maximum=sizes["posture_size"])
            self._arguments = sizes | {"joints": joints}
            self._weights = joint_weights(sizes["posture_size"], joints)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, **other._arguments, converter=converter)

        @staticmethod
        def build(policy, joints: int, arrays: dict):
            """Returns the detector for `policy`; nothing was fitted, `arrays` is empty."""
            return RecallDetector(**sizes_of(policy), joints=joints)

        def calc_errors(self, context, reference_errors):
            difference = self.posture_history.Eval(context) - self.recalled_postures.Eval(context)
            return recall_errors(difference.reshape(-1, len(self._weights)), self._weights, reference_errors)

    return Impl


RecallDetector = RecallDetector_[None]
