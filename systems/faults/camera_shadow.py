"""A shadow falls on a part of the scene."""

import numpy as np
from pydrake.systems.framework import Context

from systems.faults.picture_fault import PictureFault

DARKEST = 0.7  # at severity 1, share of the light that is gone
SOFT, OFF_CENTRE = 0.08, 0.1  # of the picture's width


class CameraShadow(PictureFault):
    """Beyond a line every pixel is 1 - 0.7 s times as bright, s the severity; the edge is 8 % of the width soft.

    The line passes at most a tenth of the width from the middle; place and direction are by the seed.

    .. pydrake_system::

        name: CameraShadow
        input_ports: [ticks_since_onset, rgb_image]
        output_ports: [acting, faulty_rgb_image]

    See PictureFault for the ports.
    """

    name = "camera_shadow"
    severity_1 = "70 % darker on one side of a line through the middle fifth of the picture"

    def _altered(self, context: Context, rgb: np.ndarray, severity: float) -> np.ndarray:
        height, width = rgb.shape[:2]
        chance = self._chance(context)
        angle, offset = chance.uniform(0.0, 2.0 * np.pi), chance.uniform(-OFF_CENTRE, OFF_CENTRE)
        y, x = np.mgrid[:height, :width]
        beyond = ((x - width / 2) * np.cos(angle) + (y - height / 2) * np.sin(angle)) / width - offset
        shade = np.clip(beyond / SOFT + 0.5, 0.0, 1.0)
        return rgb * (1.0 - DARKEST * severity * shade)[:, :, None]
