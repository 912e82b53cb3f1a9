"""Small innovations that go on: their cumulative sum (CUSUM)."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from models.data.runs import Tape
from systems.arguments import require_arrays, require_count, require_vector
from systems.detector import CalibratedDetector, period_of
from systems.innovation_detector import JUDGED, feature_innovation, posture_innovation

DRIFT = 2.0  # means on normal runs: half way between their mean, 1, and the threefold that is to be noticed


class CusumDetector(CalibratedDetector, LeafSystem):
    """S_k = max(0, S_{k-1} + l_k / r - DRIFT), one each for the innovations l of posture and features.

    Page's scheme (Continuous inspection schemes, Biometrika 41, 1954) with the l of InnovationDetector, r their mean
    on normal runs, and the allowance half way between 1 and the multiple that is to be noticed. As his scheme begins
    anew after an alarm, S becomes 0 where the network starts anew.

    .. pydrake_system::

        name: CusumDetector
        input_ports: [posture_history, recalled_postures, hidden_state, features, predicted_features, reset]
        output_ports: [errors, alpha]

    Ports: see systems/detector.py; errors (2,): S_k / mean_S. Direct feedthrough of all but hidden_state and reset.
    S_{k-1} is discrete state, 0 before the first tick.
    """

    name = "innovation_cusum"
    learns_from = "network"

    def __init__(self, policy, joints: int, reference):
        """`policy`: see `declare_detector_inputs`; joints: J; reference (2,): r > 0 of posture and features."""
        super().__init__()
        self._joints = require_count("joints", joints, maximum=policy.posture_size)
        self._reference = require_vector("reference", reference, len(JUDGED), minimum=np.finfo(float).tiny)
        self._sums = self.DeclareDiscreteState(len(JUDGED))
        reads = ("posture_history", "recalled_postures", "features", "predicted_features")
        self.declare_ports(policy, criteria=len(JUDGED), reads=reads, updates_read=("reset",), remembers=True)
        self.DeclarePeriodicDiscreteUpdateEvent(period_of(policy), 0.0, self._update)

    @staticmethod
    def fit(runs: list[Tape]) -> dict[str, np.ndarray]:
        """reference (M + 1,): mean squares of each component's innovation, and of the features'."""
        postures = np.vstack([run.recalled_postures[:, 0] - run.posture for run in runs])
        features = np.vstack([(run.predicted_features - run.features)[1:] for run in runs])
        return {"reference": np.append(np.square(postures).mean(axis=0), np.square(features).mean())}

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector of what `fit` gave; the first `joints` components are judged."""
        require_arrays(arrays, "reference")
        reference = np.asarray(arrays["reference"], float)
        return CusumDetector(policy, joints, [reference[:joints].mean(), reference[-1]])

    def calc_errors(self, context, mean_errors):
        return self._sums_now(context) / mean_errors

    def _sums_now(self, context) -> np.ndarray:
        recalled, history = self.recalled_postures.Eval(context), self.posture_history.Eval(context)
        errors = (
            posture_innovation(recalled, history, self._joints),
            feature_innovation(self.predicted_features.Eval(context), self.features.Eval(context)),
        )
        return np.maximum(context.get_discrete_state(self._sums).value() + errors / self._reference - DRIFT, 0.0)

    def _update(self, context, discrete_state):
        anew = self.reset.HasValue(context) and self.reset.Eval(context)[0] > 0.5
        discrete_state.set_value(self._sums, np.zeros(len(JUDGED)) if anew else self._sums_now(context))
