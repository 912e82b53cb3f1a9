"""The first baseline: how far is the nearest neighbour (k = 1) among the windows of the training runs?"""

import numpy as np

from systems.window_detector import WindowDetector


class KnnDetector(WindowDetector):
    """a_j = min_i || q_j - x_ij ||, the Euclidean distance to the nearest training window of joint j.

    .. pydrake_system::

        name: KnnDetector
        input_ports:
        - posture_history
        - recalled_postures
        - hidden_state
        output_ports:
        - errors
        - alpha

    Ports: see WindowDetector. Needs scikit-learn.
    """

    def __init__(self, *, windows: np.ndarray, **arguments):
        """
        Args:
            windows: (J, n, w) of the training runs, newest sample first, rad.
            arguments: of WindowDetector, but for joints and window.
        """
        from sklearn.neighbors import KDTree

        windows = np.asarray(windows, dtype=float)
        if windows.ndim != 3 or not windows.size or not np.isfinite(windows).all():
            raise ValueError(f"windows has shape {windows.shape}; it must be (J, n, w), none 0, all finite: fit again.")
        super().__init__(joints=windows.shape[0], window=windows.shape[2], **arguments)
        self._trees = [KDTree(rows) for rows in windows]

    def anomaly(self, windows: np.ndarray) -> np.ndarray:
        """See WindowDetector; rad."""
        return np.array([tree.query(rows, k=1)[0][:, 0] for tree, rows in zip(self._trees, windows, strict=True)])
