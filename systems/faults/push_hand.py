"""A person pushes the hand away."""

from systems.faults.push import Push


class PushHand(Push):
    """A level force of 40 s N on the hand, s the severity, while the joints' servo is soft.

    .. pydrake_system::

        name: PushHand
        input_ports: [ticks_since_onset, desired_posture, joint_angles, finger_gap]
        output_ports: [acting, faulty_desired_posture, spatial_force]

    See Push for the ports.
    """

    name = "push_hand"
    severity_1 = "40 N on the hand, 5 % of the joints' stiffness left"
    pushed = "hand"
    newtons = 40.0
