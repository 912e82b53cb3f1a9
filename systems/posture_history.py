"""The posture now and as sampled at the ticks before."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from systems.arguments import require_count, require_positive, require_vector


class PostureHistory(LeafSystem):
    """Samples the posture at each tick and keeps the last N + 1 samples, in whichever unit the posture comes.

    .. pydrake_system::

        name: PostureHistory
        input_ports: [posture]
        output_ports: [posture, posture_history]

    Inputs:
        posture: (M,) the measured posture, continuous in time.
    Outputs:
        posture: (M,) m_k, the newest sample: state, constant between ticks; after the update of tick k.
        posture_history: ((N + 2) M,) row by row: row 0 is the input as it is now (direct feedthrough), the others are
            the samples. What the updates of tick k read is m_k, m_{k-1}, ..., m_{k-1-N}.
    """

    def __init__(self, *, posture_size: int, horizon: int, period: float, initial_posture: np.ndarray):
        """
        Args:
            posture_size: M, number of components of a posture.
            horizon: N; N + 1 samples are kept.
            period: of the ticks, s.
            initial_posture: (M,) stands for every posture before the first tick; unit of the input.
        """
        super().__init__()
        self._size = require_count("posture_size", posture_size)
        horizon = require_count("horizon", horizon, 0)
        initial = require_vector("initial_posture", initial_posture, self._size)
        self._input = self.DeclareVectorInputPort("posture", self._size)
        self._samples = self.DeclareDiscreteState(np.tile(initial, horizon + 1))
        state = self.discrete_state_ticket(self._samples)
        self.DeclareVectorOutputPort("posture", self._size, self._calc_posture, {state})
        self.DeclareVectorOutputPort(
            "posture_history", (horizon + 2) * self._size, self._calc_history, {state, self._input.ticket()}
        )
        self.DeclarePeriodicDiscreteUpdateEvent(require_positive("period", period), 0.0, self._update)

    def _calc_posture(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(self._samples).value()[: self._size])

    def _calc_history(self, context: Context, output: BasicVector) -> None:
        samples = context.get_discrete_state(self._samples).value()
        output.SetFromVector(np.concatenate((self._input.Eval(context), samples)))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        samples = context.get_discrete_state(self._samples).value()
        discrete_state.set_value(self._samples, np.concatenate((self._input.Eval(context), samples[: -self._size])))
