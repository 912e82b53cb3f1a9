"""The paper's detector: does the network recall what the arm did (Eq. 4)? And the same, with the picture judged too."""

import functools

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from systems.arguments import require_count
from systems.detector import CalibratedDetector
from systems.innovation_detector import feature_innovation


def recall_errors(difference: np.ndarray, joints: int, mean_errors: np.ndarray) -> np.ndarray:
    """l_n / mean_l_n, (N + 1,): l_n, Eq. 4, is the mean of the squared errors over the joints.

    Under alpha = 1 the fingers keep their command whatever the network goes through: their recall is not judged.

    Args:
        difference: (N + 1, M) recalled minus measured postures (or the reverse), scaled; float or AutoDiffXd.
        joints: J, the first J components are joints.
        mean_errors: (N + 1,) mean_l_n, scaled units squared.
    """
    weights = _weights(joints, difference.shape[1])
    return (difference * difference * (weights / mean_errors[:, None])).sum(axis=1)


@functools.cache
def _weights(joints: int, size: int) -> np.ndarray:
    """(size,) 1 / joints for each joint, 0 for the other components."""
    weights = np.append(np.full(joints, 1.0 / joints), np.zeros(size - joints))
    weights.flags.writeable = False
    return weights


@TemplateSystem.define("RecallDetector_", T_list=[float, AutoDiffXd])
def RecallDetector_(T):
    class Impl(CalibratedDetector, LeafSystem_[T]):
        """l_0 judges the prediction m^R_k against m_k, l_n what c_{k-1} recalls of tick k - 1 - n against m_{k-1-n}.

        With `features` one criterion more and two inputs, features and predicted_features: the square of
        InnovationDetector's l_2, the mean square of f^R_k - f_k (dimensionless). On normal runs the largest l_2 are
        near to each other and the largest l_n far apart: by its mean the square has a largest like theirs, so that one
        gamma is right for all; l_2 itself would never come to it.

        .. pydrake_system::

            name: RecallDetector
            input_ports: [posture_history, recalled_postures, hidden_state]
            output_ports: [errors, alpha]

        Ports: see systems/detector.py; errors (N + 1,): l_n / mean_l_n, n = 0 .. N. `hidden_state` is left unread.
        Direct feedthrough of what is judged; converts to AutoDiffXd.

        Constructor: policy, any object with `posture_size` M, `horizon` N, `state_size` S, and `feature_size` F where
        features are judged; joints (J), the first J components are judged; features, whether they are too.
        """

        name = "recall"
        learns_from = "nothing"

        def _construct(self, policy, joints: int, features: bool = False, converter=None):
            LeafSystem_[T].__init__(self, converter=converter)
            reads = ("posture_history", "recalled_postures", *(("features", "predicted_features") if features else ()))
            self.declare_ports(policy, criteria=policy.horizon + 1 + features, reads=reads, scalar=T)
            self._policy, self._joints = policy, require_count("joints", joints, maximum=policy.posture_size)
            self._features = features

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, other._policy, other._joints, other._features, converter=converter)

        @staticmethod
        def build(policy, joints, arrays):
            """Returns the detector for `policy`; nothing was fitted, `arrays` is empty.

            Raises ValueError for a policy that recalls nothing.
            """
            return _build(policy, joints)

        def calc_errors(self, context, mean_errors):
            size = self._policy.posture_size
            measured = self.posture_history.Eval(context).reshape(-1, size)
            # m_{k-1}, row 1, has no counterpart: c_{k-1} has just been fed it.
            measured = np.concatenate((measured[:1], measured[2:]))
            recalled = self.recalled_postures.Eval(context).reshape(-1, size)
            found = recall_errors(measured - recalled, self._joints, mean_errors[: len(recalled)])
            if not self._features:
                return found
            seen = feature_innovation(self.predicted_features.Eval(context), self.features.Eval(context))
            return np.append(found, seen * seen / mean_errors[-1])

    return Impl


RecallDetector = RecallDetector_[None]


def _build(policy, joints: int, features: bool = False):
    """The detector for `policy`; raises ValueError for one that recalls nothing."""
    if not getattr(policy, "recalls", True):
        raise ValueError(
            f"{policy.name} recalls nothing: train recall heads on its states, or choose a detector that needs none."
        )
    return RecallDetector(policy, joints, features)


class RecallInnovation:
    """The detector that judges the picture beside the recall."""

    name = "recall_innovation"
    learns_from, fit = "nothing", RecallDetector.fit

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector for `policy`; nothing was fitted, `arrays` is empty. Raises as RecallDetector's."""
        return _build(policy, joints, features=True)
