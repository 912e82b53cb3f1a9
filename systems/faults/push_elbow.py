"""A person pushes the elbow away."""

from systems.faults.push import Push


class PushElbow(Push):
    """A level force of 80 s N on the elbow, s the severity, while the joints' servo is soft.

    .. pydrake_system::

        name: PushElbow
        input_ports: [ticks_since_onset, desired_posture, joint_angles, finger_gap]
        output_ports: [acting, faulty_desired_posture, spatial_force]

    See Push for the ports.
    """

    name = "push_elbow"
    severity_1 = "80 N on the elbow, 5 % of the joints' stiffness left"
    pushed = "elbow"
    newtons = 80.0
