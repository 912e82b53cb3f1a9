"""What detectors have in common that judge the last w samples of each joint (Sec. IV-B): KnnDetector, SubspaceDetector."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from systems.arguments import require_bounds, require_count, require_positive, require_vector
from systems.detector import declare_detector_inputs
from systems.elementwise import maximum, sigmoid


class WindowDetector(LeafSystem):
    """alpha = max_j 1 / (1 + exp(-beta (a_j / r_j - gamma))); a subclass says how anomalous a window is, a_j.

    Ports: see systems/detector.py; errors (J,): a_j / mean_a_j. `recalled_postures` and `hidden_state` are left unread.
    Direct feedthrough of `posture_history`; no state.
    """

    def __init__(
        self,
        *,
        posture_size: int,
        horizon: int,
        state_size: int,
        joints: int,
        window: int,
        lower: np.ndarray,
        upper: np.ndarray,
        reference_errors: np.ndarray,
        beta: float,
        gamma: float,
    ):
        """
        Args:
            posture_size, horizon, state_size: M, N, S of the policy.
            joints: J, the first J components of the posture are judged.
            window: w, samples in a window; at most N + 1.
            lower, upper: (M,) bounds of the scaling of the port's postures, physical units: windows are judged in these.
            reference_errors: (J,) r_j, the mean of a_j on normal runs, > 0, unit of a_j.
            beta, gamma: of the sigmoid; beta > 0.
        """
        super().__init__()
        history, _, _ = declare_detector_inputs(self, posture_size=posture_size, horizon=horizon, state_size=state_size)
        joints, window = require_count("joints", joints), require_count("window", window)
        if joints > posture_size:
            raise ValueError(f"joints is {joints}, posture_size only {posture_size}: judge at most that many.")
        if window > horizon + 1:
            raise ValueError(
                f"window is {window}, but posture_history has {horizon + 1} samples only: fit with a shorter window, or "
                "use a policy with a longer horizon."
            )
        lower, upper = require_bounds("lower", lower, "upper", upper, posture_size)
        self._reference_errors = require_vector("reference_errors", reference_errors, joints, minimum=0.0)
        if np.any(self._reference_errors == 0.0):
            raise ValueError(
                f"reference_errors is {self._reference_errors}; every component must be greater than 0, errors are divided by "
                "them: calibrate on runs in which the arm moves."
            )
        self._beta = require_positive("beta", beta)
        self._gamma = float(require_vector("gamma", [gamma], 1)[0])
        self._shape, self._window = (horizon + 1, posture_size), window
        self._half_range = 0.5 * (upper - lower)[:joints, None]
        self._centre = 0.5 * (upper + lower)[:joints, None]
        self._history = history
        self._errors = self.DeclareVectorOutputPort("errors", joints, self._calc_errors, {history.ticket()})
        self.DeclareVectorOutputPort("alpha", 1, self._calc_alpha, {history.ticket()})

    def anomaly(self, windows: np.ndarray) -> np.ndarray:
        """a_j of windows (J, n, w) in physical units, newest sample first: (J, n) >= 0."""
        raise NotImplementedError

    def _calc_errors(self, context, output):
        rows = self._history.Eval(context).reshape(self._shape)[: self._window, : len(self._reference_errors)]
        windows = rows.T * self._half_range + self._centre
        output.SetFromVector(self.anomaly(windows[:, None])[:, 0] / self._reference_errors)

    def _calc_alpha(self, context, output):
        output[0] = maximum(sigmoid(self._beta * (self._errors.Eval(context) - self._gamma)))
