"""Does what the network predicted come true? The innovations of posture and picture, apart or together."""

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from systems.arguments import require_count
from systems.detector import CalibratedDetector

JUDGED = ("posture", "features")


def posture_innovation(recalled: np.ndarray, history: np.ndarray, joints: int):
    """Mean square of m^R_k - m_k over the first `joints` components; of the ports' values, float or AutoDiffXd."""
    return np.square(recalled[:joints] - history[:joints]).mean()


def feature_innovation(predicted: np.ndarray, features: np.ndarray):
    """Mean square of f^R_k - f_k; 0 where nothing was predicted: that is exactly 0 (see systems/detector.py)."""
    square = np.square(predicted - features).mean()
    made = any((value.value() if isinstance(value, AutoDiffXd) else value) != 0.0 for value in predicted)
    return square if made else 0.0 * square


@TemplateSystem.define("InnovationDetector_", T_list=[float, AutoDiffXd])
def InnovationDetector_(T):
    class Impl(CalibratedDetector, LeafSystem_[T]):
        """l_1 = mean_j (m^R_kj - m_kj)^2 over the joints, l_2 = mean_i (f^R_ki - f_ki)^2: errors of the predictions.

        The innovation is the oldest signal of faults (Mehra and Peschon, An innovations approach to fault detection
        and diagnosis in dynamic systems, Automatica 7, 1971), here with each mean square divided by its mean on normal
        runs in the place of a covariance. l_2 alone of all our signals sees the picture at once.

        .. pydrake_system::

            name: InnovationDetector
            input_ports: [posture_history, recalled_postures, hidden_state, features, predicted_features]
            output_ports: [errors, alpha]

        Ports: see systems/detector.py; errors (E,): l / mean of what is judged. Direct feedthrough of what is judged;
        no state; converts to AutoDiffXd.

        Constructor: policy, see `declare_detector_inputs`; joints (J), the first J components are judged; judged, of
        JUDGED, one or both: without features there are no ports for them.
        """

        name = "innovation"
        learns_from = "nothing"

        def _construct(self, policy, joints: int, judged: tuple[str, ...] = JUDGED, converter=None):
            LeafSystem_[T].__init__(self, converter=converter)
            if not judged or not set(judged) <= set(JUDGED):
                raise ValueError(f"judged is {judged}; it must be one or both of {', '.join(JUDGED)}: pass such.")
            postures = ("posture_history", "recalled_postures") if "posture" in judged else ()
            features = ("features", "predicted_features") if "features" in judged else ()
            self.declare_ports(policy, criteria=len(judged), reads=(*postures, *features), scalar=T)
            self._policy, self._joints = policy, require_count("joints", joints, maximum=policy.posture_size)
            self._judged = judged

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, other._policy, other._joints, other._judged, converter=converter)

        @staticmethod
        def build(policy, joints, arrays):
            """Returns the detector for `policy`; nothing was fitted, `arrays` is empty."""
            return InnovationDetector(policy, joints)

        def calc_errors(self, context, mean_errors):
            found = []
            if "posture" in self._judged:
                recalled, history = self.recalled_postures.Eval(context), self.posture_history.Eval(context)
                found.append(posture_innovation(recalled, history, self._joints))
            if "features" in self._judged:
                found.append(feature_innovation(self.predicted_features.Eval(context), self.features.Eval(context)))
            return np.array(found) / mean_errors

    return Impl


InnovationDetector = InnovationDetector_[None]


class PostureInnovation:
    """The detector that judges the posture alone: l_1."""

    name = "innovation_posture"
    learns_from, fit = "nothing", InnovationDetector.fit

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector for `policy`; nothing was fitted, `arrays` is empty."""
        return InnovationDetector(policy, joints, ("posture",))


class FeatureInnovation:
    """The detector that judges the picture alone: l_2."""

    name = "innovation_features"
    learns_from, fit = "nothing", InnovationDetector.fit

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector for `policy`; nothing was fitted, `arrays` is empty."""
        return InnovationDetector(policy, joints, ("features",))
