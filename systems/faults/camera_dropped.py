"""Frames are lost for a while: the picture is black."""

import numpy as np
from pydrake.systems.framework import Context

from systems.faults.picture_fault import PictureFault


class CameraDropped(PictureFault):
    """A frame is black with the probability s, the severity; which ones are is by the seed and the tick.

    .. pydrake_system::

        name: CameraDropped
        input_ports: [ticks_since_onset, rgb_image]
        output_ports: [acting, faulty_rgb_image]

    See PictureFault for the ports.
    """

    name = "camera_dropped"
    severity_1 = "every frame black"
    lasts = False

    def _altered(self, context: Context, rgb: np.ndarray, severity: float) -> np.ndarray:
        lost = self._chance(context, 1 + self._ticks(context)).uniform() < severity
        return np.zeros_like(rgb) if lost else rgb
