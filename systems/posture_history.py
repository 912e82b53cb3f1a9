"""The posture as sampled at the ticks: a zero-order hold that remembers."""

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from systems.arguments import require_count, require_positive, require_vector


class PostureHistory(LeafSystem):
    """Samples the posture at each tick and keeps the last N samples, in whichever unit the posture comes.

    .. pydrake_system::

        name: PostureHistory
        input_ports: [posture]
        output_ports: [posture, posture_history]

    Inputs:
        posture: (M,) the measured posture, continuous in time.
    Outputs (state, no direct feedthrough: constant between ticks; after the update of tick k):
        posture: (M,) m_k.
        posture_history: ((N + 1) M,) m_k, m_{k-1}, ..., m_{k-N}, row by row.
    """

    def __init__(self, *, posture_size: int, horizon: int, period: float, initial_posture: np.ndarray):
        """
        Args:
            posture_size: M, number of components of a posture.
            horizon: N, number of earlier ticks kept.
            period: of the ticks, s.
            initial_posture: (M,) stands for every posture before the first tick; unit of the input.
        """
        super().__init__()
        size = require_count("posture_size", posture_size)
        horizon = require_count("horizon", horizon, 0)
        initial = require_vector("initial_posture", initial_posture, size)
        self._input = self.DeclareVectorInputPort("posture", size)
        self._sample = self.DeclareDiscreteState(initial)
        self._history = self.DeclareDiscreteState(np.tile(initial, horizon + 1))
        self.DeclareStateOutputPort("posture", self._sample)
        self.DeclareStateOutputPort("posture_history", self._history)
        self.DeclarePeriodicDiscreteUpdateEvent(require_positive("period", period), 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        posture = self._input.Eval(context)
        history = context.get_discrete_state(self._history).value()
        discrete_state.set_value(self._sample, posture)
        discrete_state.set_value(self._history, np.concatenate((posture, history[: -len(posture)])))
