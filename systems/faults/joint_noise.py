"""The sensors of the joints are noisy."""

import numpy as np
from pydrake.systems.framework import Context

from systems.faults.posture_fault import PostureFault

LARGEST = np.deg2rad(1.0)  # standard deviation at severity 1


class JointNoise(PostureFault):
    """White Gaussian noise with a standard deviation of s degrees on every joint's reading, s the severity.

    .. pydrake_system::

        name: JointNoise
        input_ports: [ticks_since_onset, posture]
        output_ports: [acting, faulty_posture]

    See PostureFault for the ports. The noise of a tick is made of the seed and the tick since the onset.
    """

    name = "joint_noise"
    severity_1 = "Gaussian of 1 degree a joint, new in each tick"

    def _altered(self, context: Context, posture: np.ndarray, severity: float) -> np.ndarray:
        noise = self._chance(context, 1 + self._ticks(context)).standard_normal(self._setting.joints)
        posture[: self._setting.joints] += severity * LARGEST * noise
        return posture
