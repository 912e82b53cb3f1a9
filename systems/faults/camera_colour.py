"""The light changes its colour: red, green and blue are multiplied each by its own."""

import numpy as np
from pydrake.systems.framework import Context

from systems.faults.picture_fault import PictureFault

LARGEST = 0.4  # at severity 1


class CameraColour(PictureFault):
    """Each channel times 1 + 0.4 s u, s the severity; u from -1 to 1 by the seed, the largest of the three +1 or -1.

    .. pydrake_system::

        name: CameraColour
        input_ports: [ticks_since_onset, rgb_image]
        output_ports: [acting, faulty_rgb_image]

    See PictureFault for the ports.
    """

    name = "camera_colour"
    severity_1 = "one of red, green, blue 40 % up or down, the others by less"

    def _altered(self, context: Context, rgb: np.ndarray, severity: float) -> np.ndarray:
        tint = self._chance(context).uniform(-1.0, 1.0, size=3)
        return rgb * (1.0 + LARGEST * severity * tint / np.abs(tint).max())
