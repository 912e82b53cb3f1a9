"""How unlikely is the noise that a flow, trained on normal runs, leads back to?"""

import numpy as np

from models.data.runs import Tape, rows_of
from models.networks.perceptron import of_arrays, random_layers, run_perceptron, to_arrays, train_perceptron
from systems.vector_detector import VectorDetector, standard, standard_of

HIDDEN = 128
STEPS = 5  # of the integration
UPDATES, BATCH = 3000, 128
RATE = 2e-3


class FlowDetector(VectorDetector):
    """l = || z(1) ||^2, dz/dt = v(z, t), z(0) = x = [c_{k-1}, f_k] standardised: -2 log of the density of its noise.

    logpZO of FAIL-Detect (Xu et al., RSS 2025, arXiv:2503.08558). v is trained by flow matching (Lipman, Chen,
    Ben-Hamu, Nickel and Le, ICLR 2023) from normal runs to noise: E || v((1 - t) x + t e, t) - (e - x) ||^2, e
    Gaussian, t uniform. Integrated by STEPS steps of Euler's method from the data on. torch trains v, numpy runs it.

    .. pydrake_system::

        name: FlowDetector
        input_ports: [posture_history, recalled_postures, hidden_state, features]
        output_ports: [errors, alpha]

    Ports: see VectorDetector.
    """

    name = "logpzo"
    reads = ("hidden_state", "features")

    def __init__(self, policy, arrays: dict[str, np.ndarray]):
        """`policy`: see VectorDetector; `arrays`: of `fit`."""
        super().__init__(policy)
        self._field, (self._mean, self._spread) = of_arrays("field", arrays), standard(arrays)
        self.require_width(self._field[0][0].shape[1] - 1)
        self.require_width(len(self._field[-1][1]))

    @staticmethod
    def fit(runs: list[Tape]) -> dict[str, np.ndarray]:
        """mean, spread (D,); field.i, weights and bias of each layer i of v, t its last input; float32. Needs torch."""
        rows = rows_of(runs, *FlowDetector.reads)
        arrays = standard_of(rows)
        mean, spread = standard(arrays)
        rows = (rows - mean) / spread

        def batch(draw):
            data, noise = rows[draw.integers(len(rows), size=BATCH)], draw.normal(size=(BATCH, rows.shape[1]))
            time = draw.random((BATCH, 1))
            return np.hstack([(1.0 - time) * data + time * noise, time]), noise - data

        sizes = (rows.shape[1] + 1, HIDDEN, HIDDEN, rows.shape[1])
        field = random_layers(sizes, np.random.default_rng(0))
        return arrays | to_arrays("field", train_perceptron(field, batch, UPDATES, seed=0, rate=RATE))

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector of what `fit` gave."""
        return FlowDetector(policy, arrays)

    def anomaly(self, rows):
        """See VectorDetector; dimensionless."""
        return np.square(self.noise(rows)).sum(axis=1)

    def noise(self, rows: np.ndarray) -> np.ndarray:
        """z(1) (n, D) of rows (n, D)."""
        z = (rows - self._mean) / self._spread
        for step in range(STEPS):
            z = z + run_perceptron(self._field, np.hstack([z, np.full((len(z), 1), step / STEPS)])) / STEPS
        return z
