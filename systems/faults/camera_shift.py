"""The camera was turned a little: the picture is shifted."""

import cv2
import numpy as np
from pydrake.systems.framework import Context

from systems.faults.picture_fault import PictureFault

LARGEST = 3.0 / 112.0  # at severity 1, of the picture's width


class CameraShift(PictureFault):
    """The picture is shifted by s times 2.7 % of its width (3 of 112 pixels), s the severity.

    Of the default world's camera that is 1.2 degrees. The direction is by the seed; between pixels it is interpolated,
    what comes in from outside repeats the edge.

    .. pydrake_system::

        name: CameraShift
        input_ports: [ticks_since_onset, rgb_image]
        output_ports: [acting, faulty_rgb_image]

    See PictureFault for the ports.
    """

    name = "camera_shift"
    severity_1 = "2.7 % of the width (3 of 112 pixels; 1.2 degrees of this camera)"

    def _altered(self, context: Context, rgb: np.ndarray, severity: float) -> np.ndarray:
        angle = self._chance(context).uniform(0.0, 2.0 * np.pi)
        by = severity * LARGEST * rgb.shape[1] * np.array([np.cos(angle), np.sin(angle)])
        moved = np.column_stack([np.eye(2), by])
        return cv2.warpAffine(rgb, moved, rgb.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
