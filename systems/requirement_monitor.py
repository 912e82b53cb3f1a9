"""Requirements in signal temporal logic, watched while the diagram runs."""

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from systems.arguments import require_count, require_positive
from systems.signal_logic import Formula
from systems.signal_logic_online import OnlineRobustness


class RequirementMonitor(LeafSystem):
    """How well the run so far keeps each requirement.

    .. pydrake_system::

        name: RequirementMonitor
        input_ports: [signals]
        output_ports: [robustness]

    Inputs:
        signals: (S,) the values of this tick, each in its own unit; constant from one tick's update to the next.
    Outputs:
        robustness: (R,) of each requirement, in their order: what `systems.signal_logic.robustness` gives at tick 0
            for the ticks up to this one. Negative: broken, so far. Direct feedthrough; to be read between two ticks.

    The update at a tick sees the signals that held until then, those of the tick before, and takes them into what the
    operators remember (see systems/signal_logic_online.py): discrete state, whose size does not depend on the run's
    length. There is none before the first tick.
    """

    def __init__(self, requirements: Mapping[str, Formula], signals: Sequence[str], period: float = 0.1):
        """
        Args:
            requirements: one or more, by name. Raises InputError for one that looks ahead.
            signals: names of the S components of the input.
            period: of the ticks, s.
        """
        super().__init__()
        count = require_count("the number of requirements", len(requirements))
        self._online = OnlineRobustness(requirements, signals)
        self._signals = self.DeclareVectorInputPort("signals", len(signals))
        self._begun = self.DeclareDiscreteState(1)  # 1: a tick was there
        self._memory = self.DeclareDiscreteState(self._online.initial)
        self.DeclareVectorOutputPort("robustness", count, self._calc_robustness)
        self.DeclarePeriodicDiscreteUpdateEvent(require_positive("period", period), 0.0, self._update)

    def _step(self, context: Context) -> tuple[np.ndarray, np.ndarray]:
        return self._online.step(context.get_discrete_state(self._memory).value(), self._signals.Eval(context))

    def _calc_robustness(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._step(context)[0])

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        if context.get_discrete_state(self._begun)[0] > 0.5:
            discrete_state.set_value(self._memory, self._step(context)[1])
        discrete_state.set_value(self._begun, [1.0])
