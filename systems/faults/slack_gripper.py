"""The gripper gets slack for a while, and may let go of what it holds."""

import numpy as np
from pydrake.systems.framework import Context

from systems.faults.servo_fault import ServoFault


class SlackGripper(ServoFault):
    """The fingers' servo has (1 - s)^2 of its stiffness left, s the severity: at 1 it holds nothing.

    .. pydrake_system::

        name: SlackGripper
        input_ports: [ticks_since_onset, desired_posture, joint_angles, finger_gap]
        output_ports: [acting, faulty_desired_posture]

    See ServoFault for the ports. It begins on the way to the second goal, when something is in the hand.
    """

    name = "slack_gripper"
    severity_1 = "no force of the fingers"
    acts_on = "servo of the fingers"
    lasts = False
    subtask = 2

    def _stiffness(self, context: Context, severity: float) -> np.ndarray:
        left = np.ones(self._setting.posture_size)
        left[self._setting.joints :] = (1.0 - severity) ** 2
        return left
