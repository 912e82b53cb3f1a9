"""How far is the hidden state from those of normal runs, in their own spread?"""

import numpy as np

from models.data.runs import Tape, rows_of
from systems.arguments import require_arrays
from systems.vector_detector import VectorDetector


class MahalanobisDetector(VectorDetector):
    """l = (c - mu)' P (c - mu) of c = c_{k-1}: the square of its Mahalanobis distance to the mean of normal runs.

    The confidence score of Lee, Lee, Lee and Shin (A simple unified framework for detecting out-of-distribution samples
    and adversarial attacks, NeurIPS 2018, Eq. 2) with one class. P is the inverse of the shrunk covariance of Ledoit
    and Wolf (A well-conditioned estimator for large-dimensional covariance matrices, J. Multivariate Analysis 88,
    2004), by scikit-learn: the states are more than the directions that they go in.

    .. pydrake_system::

        name: MahalanobisDetector
        input_ports: [posture_history, recalled_postures, hidden_state]
        output_ports: [errors, alpha]

    Ports: see VectorDetector.
    """

    name = "mahalanobis"

    def __init__(self, policy, mean: np.ndarray, whitening: np.ndarray):
        """`policy`: see VectorDetector; mean (S,) mu; whitening (S, S) W, of which W' W is P."""
        super().__init__(policy)
        self._mean, self._whitening = np.asarray(mean, float), np.asarray(whitening, float)
        self.require_width(len(self._mean))
        if self._whitening.shape != (len(self._mean),) * 2:
            raise ValueError(f"whitening has shape {self._whitening.shape}; it must be square, as mean: fit again.")

    @staticmethod
    def fit(runs: list[Tape]) -> dict[str, np.ndarray]:
        """mean (S,), whitening (S, S), lower triangular, both float32."""
        from sklearn.covariance import LedoitWolf

        found = LedoitWolf().fit(rows_of(runs, "hidden_state"))
        whitening = np.linalg.inv(np.linalg.cholesky(found.covariance_))
        return {"mean": found.location_.astype(np.float32), "whitening": whitening.astype(np.float32)}

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector of what `fit` gave."""
        require_arrays(arrays, "mean", "whitening")
        return MahalanobisDetector(policy, arrays["mean"], arrays["whitening"])

    def anomaly(self, rows):
        """See VectorDetector; dimensionless."""
        return np.square((rows - self._mean) @ self._whitening.T).sum(axis=1)
