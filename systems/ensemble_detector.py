"""Do networks that were trained alike from other seeds agree on what comes next?"""

import hashlib

import numpy as np
from pydrake.systems.framework import LeafSystem

from models.errors import InputError
from models.inference import Policy
from systems.arguments import require_count
from systems.detector import CalibratedDetector, period_of


class EnsembleDetector(CalibratedDetector, LeafSystem):
    """l = the variance of the networks' predictions of posture (mean over the joints) and features (mean over all).

    A deep ensemble (Lakshminarayanan, Pritzel and Blundell, Simple and scalable predictive uncertainty estimation using
    deep ensembles, NeurIPS 2017, Sec. 2.4): the network that acts and others of its kind, fed alike. Each keeps its
    own hidden state; all start anew together.

    .. pydrake_system::

        name: EnsembleDetector
        input_ports: [posture_history, recalled_postures, hidden_state, predicted_features, network_input, reset]
        output_ports: [errors, alpha]

    Ports: see systems/detector.py; errors (2,): l / mean_l of posture and features. Direct feedthrough of
    recalled_postures and predicted_features. Hidden state and prediction of each of the others are discrete state; what
    they are before the first tick, and at a new start, see RecurrentPolicy.

    Costs a step of each of the other networks a tick.
    """

    name = "ensemble"
    learns_from = "policies"

    def __init__(self, policy, joints: int, others: list):
        """`policy`: the one that acts; others: as it; joints: J, the first J components are judged."""
        super().__init__()
        self._size, self._others = policy.posture_size, others
        self._joints = require_count("joints", joints, maximum=self._size)
        require_count("number of other networks", len(others))
        self._memories, self._initial = [], []
        for other in others:
            sizes = other.posture_size, other.feature_size
            if sizes != (self._size, policy.feature_size):
                raise ValueError(f"another network has the sizes {sizes}: fit the ensemble for networks of one kind.")
            posture = np.clip(other.scaling.scale(other.initial_posture), -1.0, 1.0)
            prediction = np.concatenate((posture, np.zeros(other.feature_size)))
            self._initial.append((np.asarray(other.initial_state, float), prediction))
            self._memories.append(tuple(self.DeclareDiscreteState(value) for value in self._initial[-1]))
        reads, updates_read = ("recalled_postures", "predicted_features"), ("network_input", "reset")
        self.declare_ports(policy, criteria=2, reads=reads, updates_read=updates_read, remembers=True)
        self.DeclarePeriodicDiscreteUpdateEvent(period_of(policy), 0.0, self._update)

    @staticmethod
    def fit(runs: list[bytes]) -> dict[str, np.ndarray]:
        """The contents of the policies' files, uint8, by a number; raises InputError for fewer than two."""
        if len(runs) < 2:
            raise InputError("an ensemble needs two networks of a kind at least: give --policies of several seeds")
        return {str(i): np.frombuffer(content, np.uint8) for i, content in enumerate(runs)}

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector of what `fit` gave, without the network that acts itself."""
        files = [np.asarray(array, np.uint8).tobytes() for _, array in sorted(arrays.items())]
        others = [content for content in files if hashlib.sha256(content).hexdigest() != policy.hash]
        return EnsembleDetector(policy, joints, [Policy("a network of the ensemble", content) for content in others])

    def calc_errors(self, context, mean_errors):
        posture = self.recalled_postures.Eval(context)[: self._size]
        own = np.concatenate((posture, self.predicted_features.Eval(context)))
        told = [context.get_discrete_state(prediction).value() for _, prediction in self._memories]
        spread = np.var([own, *told], axis=0)
        return np.array([spread[: self._joints].mean(), spread[self._size :].mean()]) / mean_errors

    def _update(self, context, discrete_state):
        anew = self.reset.HasValue(context) and self.reset.Eval(context)[0] > 0.5
        for other, (hidden, prediction), initial in zip(self._others, self._memories, self._initial, strict=True):
            state, predicted = initial
            if not anew:
                x = self.network_input.Eval(context)
                predicted, state, _ = other.step(x, context.get_discrete_state(hidden).value().copy())
            discrete_state.set_value(hidden, state)
            discrete_state.set_value(prediction, np.clip(predicted, -1.0, 1.0))
