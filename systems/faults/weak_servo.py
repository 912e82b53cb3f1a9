"""The servo of one joint gets weak."""

import numpy as np
from pydrake.systems.framework import Context

from systems.faults.servo_fault import ServoFault

LARGEST = 0.95  # share of the stiffness that is gone at severity 1


class WeakServo(ServoFault):
    """One joint's servo has 1 - 0.95 s of its stiffness left, s the severity; which joint the seed says.

    .. pydrake_system::

        name: WeakServo
        input_ports: [ticks_since_onset, desired_posture, joint_angles, finger_gap]
        output_ports: [acting, faulty_desired_posture]

    See ServoFault for the ports. The compensation of gravity is not touched.
    """

    name = "weak_servo"
    severity_1 = "5 % of one joint's stiffness left"

    def _stiffness(self, context: Context, severity: float) -> np.ndarray:
        left = np.ones(self._setting.posture_size)
        left[self._chance(context).integers(self._setting.joints)] -= LARGEST * severity
        return left
