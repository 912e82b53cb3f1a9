"""What a detector could reach: it is told of the fault."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from systems.arguments import require_count
from systems.detector import declare_detector_inputs, period_of

HOME = np.deg2rad(3.0)  # a joint that is nearer to its initial angle is at home, rad
LONGEST = 30  # ticks of a fault that are noticed: 3 s, longer than anything that somebody does to the arm


class OracleDetector(LeafSystem):
    """alpha is 1 from the tick after the fault's onset until it is over and every joint is at home once, else 0.

    The flag alone would give the arm back where the fault has left it: so alpha stays 1 on the way home, as a detector
    is asked to (diagrams/episodes/switching.py). Of a fault that lasts longer than LONGEST ticks the rest is not told:
    else one that never ends would keep the arm at home for ever. So it is worth one return.

    .. pydrake_system::

        name: OracleDetector
        input_ports: [posture_history, recalled_postures, hidden_state, active]
        output_ports: [errors, alpha]

    Ports: see systems/detector.py; errors (1,): alpha. Direct feedthrough of `active`. Whether the arm is on its way
    home, and for how long the fault has acted, is discrete state. No calibration.
    """

    name = "oracle"
    learns_from = "nothing"
    has_gamma = False

    def __init__(self, policy, joints: int):
        """`policy`: any object with `posture_size`, `horizon`, `state_size`, `scaling`, `initial_posture`; joints: J,
        the first J components are brought home.
        """
        super().__init__()
        joints = require_count("joints", joints, maximum=policy.posture_size)
        self._initial = policy.scaling.scale(np.asarray(policy.initial_posture, float))[:joints]
        self._tolerance = HOME / policy.scaling.half_range[:joints]
        self._posture_history, _, _, self._active = declare_detector_inputs(self, policy, "active")
        self._returning = self.DeclareDiscreteState(1)
        self._ticks = self.DeclareDiscreteState(1)
        reads = {self._active.ticket(), self.xd_ticket()}
        for port in ("errors", "alpha"):
            self.DeclareVectorOutputPort(port, 1, self._calc_alpha, reads)
        self.DeclarePeriodicDiscreteUpdateEvent(period_of(policy), 0.0, self._update)

    @staticmethod
    def fit(runs):
        """Nothing is learned from `runs`."""
        return {}

    @staticmethod
    def build(policy, joints, arrays):
        """Returns the detector for `policy`; `arrays` is empty."""
        return OracleDetector(policy, joints)

    def set_calibration(self, context, mean_errors, beta, gamma):
        """Leaves `context` as it is."""

    def _is_active(self, context) -> bool:
        told = self._active.Eval(context)[0] > 0.5
        return bool(told and context.get_discrete_state(self._ticks)[0] < LONGEST)

    def _calc_alpha(self, context, output):
        output[0] = float(self._is_active(context) or context.get_discrete_state(self._returning)[0] > 0.5)

    def _update(self, context, discrete_state):
        joints = self._posture_history.Eval(context)[: len(self._initial)]
        away = np.any(np.abs(joints - self._initial) > self._tolerance)
        returning = context.get_discrete_state(self._returning)[0] > 0.5
        discrete_state.set_value(self._returning, [float(self._is_active(context) or (returning and away))])
        ticks = context.get_discrete_state(self._ticks)[0] + 1.0 if self._active.Eval(context)[0] > 0.5 else 0.0
        discrete_state.set_value(self._ticks, [min(ticks, LONGEST)])
