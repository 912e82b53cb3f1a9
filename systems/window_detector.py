"""What detectors have in common that judge the last w samples of each joint (Sec. IV-B)."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from systems.arguments import require_count
from systems.detector import CalibratedDetector


class WindowDetector(CalibratedDetector, LeafSystem):
    """Each joint is a criterion, l_j = a_j: how anomalous its window is, by a subclass's `anomaly`.

    Ports: see systems/detector.py; errors (J,): a_j / mean_a_j. `recalled_postures` and `hidden_state` are left unread.
    Direct feedthrough of `posture_history`; no state.
    """

    def __init__(self, policy, joints: int, window: int):
        """
        Args:
            policy: any object with `posture_size` M, `horizon` N, `state_size` S and `scaling`.
            joints: J, the first J components of the posture are judged.
            window: w, samples in a window, the newest is m_k; at most N + 2.
        """
        super().__init__()
        self.declare_ports(policy, criteria=joints, reads=("posture_history",))
        self._policy = policy
        self._joints = require_count("joints", joints, maximum=policy.posture_size)
        self._window = require_count("window", window, maximum=policy.horizon + 2)

    def anomaly(self, windows: np.ndarray) -> np.ndarray:
        """a_j of windows (J, n, w) in physical units, newest sample first: (J, n) >= 0."""
        raise NotImplementedError

    def calc_errors(self, context, mean_errors):
        rows = self.posture_history.Eval(context).reshape(-1, self._policy.posture_size)[: self._window]
        windows = self._policy.scaling.unscale(rows).T[: self._joints, None]
        return self.anomaly(windows)[:, 0] / mean_errors
