"""No detector: the network alone, what the switching is measured against."""

from pydrake.systems.framework import LeafSystem

from systems.detector import declare_detector_inputs


class NeverDetector(LeafSystem):
    """Never notices anything: alpha is 0.

    .. pydrake_system::

        name: NeverDetector
        input_ports: [posture_history, recalled_postures, hidden_state]
        output_ports: [errors, alpha]

    Ports: see systems/detector.py; errors (1,): 0. All inputs are left unread. No state, no calibration.
    """

    name = "never"
    learns_from = "nothing"
    has_gamma = False

    def __init__(self, policy):
        """`policy`: any object with `posture_size` M, `horizon` N, `state_size` S."""
        super().__init__()
        declare_detector_inputs(self, policy)
        for port in ("errors", "alpha"):
            self.DeclareVectorOutputPort(port, 1, lambda _, output: output.SetZero(), {self.nothing_ticket()})

    @staticmethod
    def fit(runs):
        """Nothing is learned from `runs`."""
        return {}

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector for `policy`; it judges no joint, `arrays` is empty."""
        return NeverDetector(policy)

    def set_calibration(self, context, mean_errors, beta, gamma):
        """Leaves `context` as it is."""
