"""The arm is moved away, and once more as soon as the network has it again."""

from systems.faults.repeated_disturbance import LOW, RepeatedDisturbance


class DisturbedResumption(RepeatedDisturbance):
    """The arm is moved away, and once more as soon as the network has it again.

    .. pydrake_system::

        name: DisturbedResumption
        input_ports: [ticks_since_onset, desired_posture, alpha]
        output_ports: [acting, faulty_desired_posture]

    See RepeatedDisturbance for the ports.
    """

    name = "disturbed_resumption"
    severity_1 = "moved 15 to 40 degrees as under A, and again in the tick in which alpha has fallen to 0.1"

    def _due(self, rest: int, alpha: float, risen: bool) -> bool:
        return risen and alpha <= LOW
