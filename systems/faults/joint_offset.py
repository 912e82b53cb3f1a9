"""The sensor of one joint is off by a constant."""

import numpy as np
from pydrake.systems.framework import Context

from systems.faults.posture_fault import PostureFault

LARGEST = np.deg2rad(5.0)  # at severity 1


class JointOffset(PostureFault):
    """One joint is read 5 s degrees too far, or too near, s the severity; which joint and which side the seed says.

    .. pydrake_system::

        name: JointOffset
        input_ports: [ticks_since_onset, posture]
        output_ports: [acting, faulty_posture]

    See PostureFault for the ports.
    """

    name = "joint_offset"
    severity_1 = "one joint read 5 degrees off"

    def _altered(self, context: Context, posture: np.ndarray, severity: float) -> np.ndarray:
        chance = self._chance(context)
        joint, side = int(chance.integers(self._setting.joints)), chance.choice([-1.0, 1.0])
        posture[joint] += side * severity * LARGEST
        return posture
