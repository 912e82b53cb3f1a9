"""The can is toppled while the hand comes."""

import numpy as np
from pydrake.systems.framework import Context

from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.faults.scene_fault import PoseFault
from diagrams.world.names import CAN_HALF_HEIGHT, CAN_RADIUS

LARGEST = np.pi / 2  # rad, at severity 1


class CanToppled(PoseFault):
    """The can is tilted by 90 s degrees, s the severity, and let go; to which side the seed says.

    .. pydrake_system::

        name: CanToppled
        input_ports: [ticks_since_onset]
        output_ports: [acting, can_pose]

    See PoseFault for the ports. Its rim touches the desk. Below 28 degrees it falls back on its feet.
    """

    name = "can_toppled"
    severity_1 = "tilted by 90 degrees: it lies"
    subtask = 1

    def _placed(self, context: Context, given: DisturbanceSpec, stands: np.ndarray) -> np.ndarray:
        tilt, side = LARGEST * self.severity(context), self._chance(context).uniform(0.0, 2.0 * np.pi)
        axis = np.array([np.cos(side), np.sin(side), 0.0])
        foot = stands[2] - CAN_HALF_HEIGHT
        height = foot + CAN_HALF_HEIGHT * np.cos(tilt) + CAN_RADIUS * np.sin(tilt)
        return np.array([np.cos(tilt / 2), *(np.sin(tilt / 2) * axis), *stands[:2], height])
