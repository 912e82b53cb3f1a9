"""Something is held before the camera for a while."""

import numpy as np
from pydrake.systems.framework import Context

from systems.faults.picture_fault import PictureFault

LARGEST = 0.5  # side at severity 1, of the picture's width
GREY = 90


class CameraOcclusion(PictureFault):
    """A grey square with a side of s times half the picture's width covers a part of the picture, s the severity.

    Its place, all of it in the picture, is by the seed.

    .. pydrake_system::

        name: CameraOcclusion
        input_ports: [ticks_since_onset, rgb_image]
        output_ports: [acting, faulty_rgb_image]

    See PictureFault for the ports.
    """

    name = "camera_occlusion"
    severity_1 = "a grey square of half the picture's width"
    lasts = False

    def _altered(self, context: Context, rgb: np.ndarray, severity: float) -> np.ndarray:
        height, width = rgb.shape[:2]
        side = min(max(round(severity * LARGEST * width), 1), height)
        row, column = np.rint(self._chance(context).uniform(size=2) * (height - side, width - side)).astype(int)
        rgb[row : row + side, column : column + side] = GREY
        return rgb
