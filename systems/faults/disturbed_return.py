"""The arm is moved away, and once more on its way home."""

from systems.faults.repeated_disturbance import HIGH, RepeatedDisturbance

WAIT = 8  # ticks of the way home: about half of it


class DisturbedReturn(RepeatedDisturbance):
    """The arm is moved away, and once more on its way home.

    .. pydrake_system::

        name: DisturbedReturn
        input_ports: [ticks_since_onset, desired_posture, alpha]
        output_ports: [acting, faulty_desired_posture]

    See RepeatedDisturbance for the ports.
    """

    name = "disturbed_return"
    severity_1 = "moved 15 to 40 degrees as under A, and again 0.8 s into the return"

    home_share = 0.5

    def _due(self, rest: int, alpha: float, risen: bool) -> bool:
        return rest >= WAIT and alpha >= HIGH
