"""The camera's pixels are noisy."""

import numpy as np
from pydrake.systems.framework import Context

from systems.faults.picture_fault import PictureFault

LARGEST = 30.0  # standard deviation at severity 1, of 255


class CameraNoise(PictureFault):
    """White Gaussian noise with a standard deviation of 30 s (of 255) on every pixel and channel, s the severity.

    That of a tick is made of the seed and the tick since the onset.

    .. pydrake_system::

        name: CameraNoise
        input_ports: [ticks_since_onset, rgb_image]
        output_ports: [acting, faulty_rgb_image]

    See PictureFault for the ports.
    """

    name = "camera_noise"
    severity_1 = "Gaussian of 30 of 255 a pixel and channel, new in each tick"

    def _altered(self, context: Context, rgb: np.ndarray, severity: float) -> np.ndarray:
        noise = self._chance(context, 1 + self._ticks(context)).standard_normal(rgb.shape, np.float32)
        return rgb + LARGEST * severity * noise
