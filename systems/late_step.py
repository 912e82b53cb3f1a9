"""A fault of the computer: the controller's step comes too late, and the arm goes on with the command that it has."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from systems.arguments import require_count, require_positive


class LateStep(LeafSystem):
    """Passes the command through, except in ticks whose step is late.

    .. pydrake_system::

        name: LateStep
        input_ports: [desired_posture, severity]
        output_ports: [followed_posture]

    Inputs:
        desired_posture: (M,) command of the controller, constant between ticks; any unit.
        severity: (1,) in [0, 1], the share of the ticks that are late; read at the ticks only.
    Outputs:
        followed_posture: (M,) the input; in a late tick, what it was in the tick before. Direct feedthrough of
            `desired_posture` alone.

    Which ticks are late is drawn by the seed, a parameter of the Context, and the tick's number alone: a larger
    severity makes more of them late, beside those of a smaller one. Whether this tick is late, and the command that it
    holds, are discrete state.
    """

    def __init__(self, *, posture_size: int, period: float = 0.1):
        """
        Args:
            posture_size: M.
            period: of the ticks, s.
        """
        super().__init__()
        self._size, self._period = require_count("posture_size", posture_size), require_positive("period", period)
        self._seed = self.DeclareAbstractParameter(AbstractValue.Make(0))
        self._desired = self.DeclareVectorInputPort("desired_posture", self._size)
        self._severity = self.DeclareVectorInputPort("severity", 1)
        self._late = self.DeclareDiscreteState(1)
        self._held = self.DeclareDiscreteState(self._size)
        self.DeclareVectorOutputPort(
            "followed_posture", self._size, self._calc_posture, {self.xd_ticket(), self._desired.ticket()}
        )
        self.DeclarePeriodicDiscreteUpdateEvent(self._period, 0.0, self._update)

    def set_seed(self, context: Context, seed: int) -> None:
        """Sets the seed, 0 or more, in this system's Context."""
        context.get_mutable_abstract_parameter(self._seed).set_value(require_count("seed", seed, 0))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        severity, late = self._severity.Eval(context)[0], False
        if severity > 0.0:
            tick = round(context.get_time() / self._period)
            drawn = np.random.default_rng((context.get_abstract_parameter(self._seed).get_value(), tick)).random()
            late = bool(drawn < severity)
        if late:
            # The update sees the command of the tick before, which is what the arm follows until now.
            discrete_state.set_value(self._held, self.GetOutputPort("followed_posture").Eval(context))
        discrete_state.set_value(self._late, [float(late)])

    def _calc_posture(self, context: Context, output: BasicVector) -> None:
        late = context.get_discrete_state(self._late)[0] > 0.5
        output.SetFromVector(context.get_discrete_state(self._held).value() if late else self._desired.Eval(context))
