"""How far is what the network sees and holds from the nearest of the clusters that normal runs fall into?"""

import numpy as np

from models.data.runs import Tape, rows_of
from systems.arguments import require_arrays
from systems.vector_detector import VectorDetector

CLUSTERS = 64
VARIANCE = 0.98  # share that the kept axes explain


class ClustersDetector(VectorDetector):
    """l = min_i || A (x - mu) - m_i ||, x = [c_{k-1}, f_k], A the principal axes of normal runs, m_i their k-means.

    The baseline PCA-kmeans of Liu et al. (Model-based runtime monitoring with interactive imitation learning, ICRA
    2024) with the 64 clusters that Xu et al. give it (FAIL-Detect, RSS 2025, arXiv:2503.08558), both by scikit-learn.

    .. pydrake_system::

        name: ClustersDetector
        input_ports: [posture_history, recalled_postures, hidden_state, features]
        output_ports: [errors, alpha]

    Ports: see VectorDetector.
    """

    name = "pca_kmeans"
    reads = ("hidden_state", "features")

    def __init__(self, policy, mean: np.ndarray, axes: np.ndarray, centres: np.ndarray):
        """`policy`: see VectorDetector; mean (D,) mu; axes (A, D), orthonormal rows; centres (C, A) m_i."""
        super().__init__(policy)
        self._mean, self._axes, self._centres = (np.asarray(array, float) for array in (mean, axes, centres))
        self.require_width(len(self._mean))
        if self._axes.ndim != 2 or self._axes.shape != (self._centres.shape[-1], len(self._mean)):
            shapes = f"{self._axes.shape} and {self._centres.shape}"
            raise ValueError(f"axes and centres have the shapes {shapes}; (A, D) and (C, A) are needed: fit again.")

    @staticmethod
    def fit(runs: list[Tape]) -> dict[str, np.ndarray]:
        """mean (D,), axes (A, D) that explain VARIANCE, centres (CLUSTERS, A); float32."""
        from sklearn.cluster import KMeans
        from sklearn.decomposition import PCA

        rows = rows_of(runs, *ClustersDetector.reads)
        found = PCA(VARIANCE, svd_solver="full").fit(rows)
        clusters = KMeans(min(CLUSTERS, len(rows)), n_init=3, random_state=0).fit(found.transform(rows))
        arrays = {"mean": found.mean_, "axes": found.components_, "centres": clusters.cluster_centers_}
        return {name: array.astype(np.float32) for name, array in arrays.items()}

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector of what `fit` gave."""
        require_arrays(arrays, "mean", "axes", "centres")
        return ClustersDetector(policy, **arrays)

    def anomaly(self, rows):
        """See VectorDetector; dimensionless."""
        inside = (rows - self._mean) @ self._axes.T
        return np.sqrt(np.square(inside[:, None] - self._centres).sum(axis=2).min(axis=1))
