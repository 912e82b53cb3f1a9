"""What detectors have in common that judge the last w samples of each joint (Sec. IV-B): KnnDetector, SubspaceDetector."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from systems.arguments import require_count
from systems.detector import CalibratedDetector, sizes_of


class WindowDetector(CalibratedDetector, LeafSystem):
    """Each joint is a criterion, l_j = a_j: how anomalous its window is; a subclass defines `anomaly`.

    Ports: see systems/detector.py; errors (J,): a_j / r_j. `recalled_postures` and `hidden_state` are left unread.
    Direct feedthrough of `posture_history`; no state.
    """

    def __init__(self, policy, joints: int, window: int):
        """
        Args:
            policy: any object with `posture_size` M, `horizon` N, `state_size` S and `scaling`; windows are judged in
                physical units.
            joints: J, the first J components of the posture are judged.
            window: w, samples in a window; at most N + 1.
        """
        super().__init__()
        sizes = sizes_of(policy)
        self._joints = require_count("joints", joints, maximum=sizes["posture_size"])
        self._window = require_count("window", window)
        if window > sizes["horizon"] + 1:
            raise ValueError(
                f"window is {window}, but posture_history has {sizes['horizon'] + 1} samples only: fit with a shorter "
                "window, or use a policy with a longer horizon."
            )
        self._scaling, self._size = policy.scaling, sizes["posture_size"]
        self.declare_ports(sizes, criteria=joints, reads=("posture_history",))

    def anomaly(self, windows: np.ndarray) -> np.ndarray:
        """a_j of windows (J, n, w) in physical units, newest sample first: (J, n) >= 0."""
        raise NotImplementedError

    def calc_errors(self, context, reference_errors):
        rows = self._scaling.unscale(self.posture_history.Eval(context).reshape(-1, self._size)[: self._window])
        return self.anomaly(rows.T[: self._joints, None])[:, 0] / reference_errors
