"""When the network starts anew: the arm is at home, and what it imagines is not."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from systems.arguments import require_count, require_vector
from systems.detector import GUARD


class HomeReset(LeafSystem):
    """Says at which ticks the network takes its initial state again: see RecurrentPolicy.

    That is while alpha >= 1/2 and every joint is at the initial posture. The network was trained to begin each subtask
    there in c_0, and what c_0 recalls is an arm at rest there: so the loop closes as soon as the arm has rested, not
    only when the network has imagined the subtask to its end.

    .. pydrake_system::

        name: HomeReset
        input_ports: [posture, alpha]
        output_ports: [reset]

    Inputs:
        posture: (M,) m_k, unit of the initial posture.
        alpha: (1,) alpha_k in [0, 1].
    Outputs:
        reset: (1,) 1 at such a tick, else 0. Direct feedthrough of both. A step has no derivative: no AutoDiff.

    The tolerance is a parameter of the Context; negative ones switch it off.
    """

    def __init__(self, *, posture_size: int, initial_posture: np.ndarray, tolerance: np.ndarray):
        """
        Args:
            posture_size: M.
            initial_posture: (J,) of the first J components, the joints.
            tolerance: (J,) largest deviation of a joint that is at home; same unit. Where one is negative, there is no
                reset.
        """
        super().__init__()
        size = require_count("posture_size", posture_size)
        joints = require_count("joints", len(initial_posture), maximum=size)
        self._initial = require_vector("initial_posture", initial_posture, joints)
        self._tolerance = self.DeclareNumericParameter(BasicVector(require_vector("tolerance", tolerance, joints)))
        self._posture = self.DeclareVectorInputPort("posture", size)
        self._alpha = self.DeclareVectorInputPort("alpha", 1)
        reads = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        self.DeclareVectorOutputPort("reset", 1, self._calc_reset, reads)

    def set_tolerance(self, context: Context, tolerance: np.ndarray) -> None:
        """Sets `tolerance` (J,), see the constructor, in this system's `context`."""
        context.get_mutable_numeric_parameter(self._tolerance).SetFromVector(tolerance)

    def _calc_reset(self, context: Context, output: BasicVector) -> None:
        away = self._alpha.Eval(context)[0] >= GUARD
        tolerance = context.get_numeric_parameter(self._tolerance).value()
        offset = np.abs(self._posture.Eval(context)[: len(self._initial)] - self._initial)
        output.SetAtIndex(0, float(away and np.all(offset <= tolerance)))
