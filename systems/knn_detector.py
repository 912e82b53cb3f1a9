"""The first baseline: how far is the nearest neighbour (k = 1) among the windows of the training runs?"""

import numpy as np

from models.data.windows import decode_runs, encode_runs, posture_windows
from systems.arguments import require_arrays
from systems.window_detector import WindowDetector


class KnnDetector(WindowDetector):
    """a_j = min_i || q_j - x_ij ||, the Euclidean distance to the nearest training window of joint j, rad.

    The search takes the longer the farther the arm is from what was taught: off it, over a millisecond.

    .. pydrake_system::

        name: KnnDetector
        input_ports: [posture_history, recalled_postures, hidden_state]
        output_ports: [errors, alpha]

    Ports: see WindowDetector. Needs scikit-learn.
    """

    name = "knn"

    def __init__(self, policy, windows: np.ndarray):
        """`policy`: see WindowDetector; `windows`: (J, n, w) of the training runs, newest sample first, rad."""
        from sklearn.neighbors import KDTree

        windows = np.asarray(windows, dtype=float)
        if windows.ndim != 3 or not windows.size or not np.isfinite(windows).all():
            raise ValueError(f"windows has shape {windows.shape}; it must be (J, n, w), none 0, all finite: fit again.")
        super().__init__(policy, joints=windows.shape[0], window=windows.shape[2])
        self._trees = [KDTree(rows) for rows in windows]

    @staticmethod
    def fit(runs):
        """The runs themselves: angles, lengths (see models/data/windows.py)."""
        return encode_runs(runs)

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector of what `fit` gave; the first `joints` columns of the runs are judged."""
        require_arrays(arrays, "angles", "lengths", *({"unit"} & arrays.keys()))
        return KnnDetector(policy, posture_windows(decode_runs(arrays))[:joints])

    def anomaly(self, windows):
        """See WindowDetector; rad."""
        return np.array([tree.query(rows, k=1)[0][:, 0] for tree, rows in zip(self._trees, windows, strict=True)])
