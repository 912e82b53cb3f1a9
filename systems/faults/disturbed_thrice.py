"""The arm is moved away three times."""

from systems.faults.repeated_disturbance import RepeatedDisturbance

WAIT = 60  # ticks between two


class DisturbedThrice(RepeatedDisturbance):
    """The arm is moved away three times.

    .. pydrake_system::

        name: DisturbedThrice
        input_ports: [ticks_since_onset, desired_posture, alpha]
        output_ports: [acting, faulty_desired_posture]

    See RepeatedDisturbance for the ports.
    """

    name = "disturbed_thrice"
    severity_1 = "moved 15 to 40 degrees as under A, three times, 6 s between"
    targets = 3

    def _due(self, rest: int, alpha: float, risen: bool) -> bool:
        return rest >= WAIT
