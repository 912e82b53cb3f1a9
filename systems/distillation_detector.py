"""How badly does a network that learned another, random one on normal runs imitate it now?"""

import numpy as np

from models.data.runs import Tape, rows_of
from models.networks.perceptron import of_arrays, random_layers, run_perceptron, to_arrays, train_perceptron
from systems.vector_detector import VectorDetector, standard, standard_of

HIDDEN, OUT = 128, 32  # units; of target and predictor
UPDATES, BATCH = 3000, 128
RATE = 1e-3


class DistillationDetector(VectorDetector):
    """l = || g(x) - h(x) ||^2, x = [c_{k-1}, f_k] standardised, h a random network, g trained to equal it.

    Random network distillation (Burda, Edwards, Storkey and Klimov, Exploration by random network distillation, ICLR
    2019, Sec. 2.2), as a monitor of policies in FAIL-Detect (Xu et al., RSS 2025, arXiv:2503.08558). g has one layer
    more than h; torch trains it, numpy runs both.

    .. pydrake_system::

        name: DistillationDetector
        input_ports: [posture_history, recalled_postures, hidden_state, features]
        output_ports: [errors, alpha]

    Ports: see VectorDetector.
    """

    name = "rnd"
    reads = ("hidden_state", "features")

    def __init__(self, policy, arrays: dict[str, np.ndarray]):
        """`policy`: see VectorDetector; `arrays`: of `fit`."""
        super().__init__(policy)
        self._target, self._predictor = of_arrays("target", arrays), of_arrays("predictor", arrays)
        self._mean, self._spread = standard(arrays)
        for layers in (self._target, self._predictor):
            self.require_width(layers[0][0].shape[1])
        if len(self._target[-1][1]) != len(self._predictor[-1][1]):
            raise ValueError("target and predictor differ in the number of their outputs: fit again.")

    @staticmethod
    def fit(runs: list[Tape]) -> dict[str, np.ndarray]:
        """mean, spread (D,); target.i and predictor.i, weights and bias of each layer i; float32. Needs torch."""
        rows = rows_of(runs, *DistillationDetector.reads)
        arrays = standard_of(rows)
        mean, spread = standard(arrays)
        rows, rng = (rows - mean) / spread, np.random.default_rng(0)
        target = random_layers((rows.shape[1], HIDDEN, OUT), rng)
        answers = run_perceptron(target, rows)

        def batch(draw):
            drawn = draw.integers(len(rows), size=BATCH)
            return rows[drawn], answers[drawn]

        predictor = random_layers((rows.shape[1], HIDDEN, HIDDEN, OUT), rng)
        predictor = train_perceptron(predictor, batch, UPDATES, seed=0, rate=RATE)
        return arrays | to_arrays("target", target) | to_arrays("predictor", predictor)

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector of what `fit` gave."""
        return DistillationDetector(policy, arrays)

    def anomaly(self, rows):
        """See VectorDetector; dimensionless."""
        rows = (rows - self._mean) / self._spread
        difference = run_perceptron(self._predictor, rows) - run_perceptron(self._target, rows)
        return np.square(difference.astype(float)).sum(axis=1)
