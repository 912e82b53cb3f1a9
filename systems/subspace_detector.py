"""The second baseline: how much of a window is outside the leading axes of the training runs' windows?"""

import numpy as np

from models.data.windows import decode_runs, encode_runs, leading_axes, posture_windows
from systems.arguments import require_arrays
from systems.window_detector import WindowDetector


class SubspaceDetector(WindowDetector):
    """a_j = ||q_j||^2 - ||U_j' q_j||^2, the squared residual of the window of joint j, rad^2.

    The leading axes are near {constant, ramp}: an arm that stands still has no residual.

    .. pydrake_system::

        name: SubspaceDetector
        input_ports: [posture_history, recalled_postures, hidden_state]
        output_ports: [errors, alpha]

    Ports: see WindowDetector.
    """

    name = "subspace"

    def __init__(self, policy, axes: np.ndarray):
        """`policy`: see WindowDetector; `axes`: (J, w, A) U, orthonormal columns, newest sample first."""
        axes = np.asarray(axes, dtype=float)
        if axes.ndim != 3 or not axes.size:
            raise ValueError(f"axes has shape {axes.shape}; it must be (J, w, A), none 0: fit again.")
        gram = axes.swapaxes(1, 2) @ axes
        off = np.abs(gram - np.eye(axes.shape[2])).max(axis=(1, 2))
        if not np.all(off <= 1e-5):  # nor where one is not finite
            joint = int(np.argmax(np.nan_to_num(off, nan=np.inf)))
            raise ValueError(f"the axes of joint {joint + 1} are not orthonormal (off by {off[joint]:.3g}): fit again.")
        super().__init__(policy, joints=axes.shape[0], window=axes.shape[1])
        self._outside = np.eye(axes.shape[1]) - axes @ axes.swapaxes(1, 2)

    @staticmethod
    def fit(runs):
        """axes (J, w, 2) float32 of the runs, rounded as the first baseline keeps them."""
        return {"axes": leading_axes(posture_windows(decode_runs(encode_runs(runs))))}

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector of what `fit` gave; the first `joints` of its axes are taken."""
        require_arrays(arrays, "axes")
        return SubspaceDetector(policy, arrays["axes"][:joints])

    def anomaly(self, windows):
        """See WindowDetector; rad^2."""
        # The residual's own length: the difference of the two squares would lose it to rounding.
        return np.square(windows @ self._outside).sum(axis=2)
