"""The camera is out of focus."""

import cv2
import numpy as np
from pydrake.systems.framework import Context

from systems.faults.picture_fault import PictureFault

LARGEST = 3.0 / 112.0  # standard deviation at severity 1, of the picture's width


class CameraBlur(PictureFault):
    """A Gaussian blur with a standard deviation of 2.7 s % of the picture's width (3 of 112 pixels), s the severity.

    .. pydrake_system::

        name: CameraBlur
        input_ports: [ticks_since_onset, rgb_image]
        output_ports: [acting, faulty_rgb_image]

    See PictureFault for the ports.
    """

    name = "camera_blur"
    severity_1 = "Gaussian of 2.7 % of the width (3 of 112 pixels)"

    def _altered(self, context: Context, rgb: np.ndarray, severity: float) -> np.ndarray:
        return cv2.GaussianBlur(rgb, (0, 0), severity * LARGEST * rgb.shape[1])
