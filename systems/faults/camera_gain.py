"""The light changes: every pixel is multiplied."""

import numpy as np
from pydrake.systems.framework import Context

from systems.faults.picture_fault import PictureFault

LARGEST = 0.4  # at severity 1


class CameraGain(PictureFault):
    """Every pixel times 1 + 0.4 s or 1 - 0.4 s, s the severity; which of the two the seed says.

    .. pydrake_system::

        name: CameraGain
        input_ports: [ticks_since_onset, rgb_image]
        output_ports: [acting, faulty_rgb_image]

    See PictureFault for the ports.
    """

    name = "camera_gain"
    severity_1 = "40 % brighter or darker, one of the two by the seed"

    def _altered(self, context: Context, rgb: np.ndarray, severity: float) -> np.ndarray:
        return rgb * (1.0 + LARGEST * severity * self._chance(context).choice([-1.0, 1.0]))
