"""A dwell time after the switch back, while the network's input turns from imagined to seen."""

from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from systems.arguments import require_count

GUARD = 0.5  # alpha below it: the network has the arm


@TemplateSystem.define("DwellTime_", T_list=[float, AutoDiffXd])
def DwellTime_(T):
    class Impl(LeafSystem_[T]):
        """alpha_k of the detector, but 0 in the `dwell_ticks` ticks after the one at which alpha fell below 1/2.

        At the tick after that, the network sees for the first time again what is, not what it imagined (Eqs. 7, 8).
        What it recalls then of the tick before is off for a moment: alpha would rise for a tick or two, and fall again.
        With W dwell ticks a stay below 1/2 lasts W + 1 ticks at least, so that the guard is crossed twice in W + 2
        ticks at most.

        .. pydrake_system::

            name: DwellTime
            input_ports: [detector_alpha, last_alphas]
            output_ports: [alpha]

        Inputs:
            detector_alpha: (1,) in [0, 1].
            last_alphas: (D,) alpha_{k-1}, ..., alpha_{k-D}, of this output.
        Outputs:
            alpha: (1,) in [0, 1].
        Direct feedthrough; converts to AutoDiffXd.

        Constructor: keywords history (D); dwell_ticks (W), 0 <= W < D.
        """

        def _construct(self, *, history: int, dwell_ticks: int, converter=None):
            LeafSystem_[T].__init__(self, converter=converter)
            self._history = require_count("history", history)
            self._ticks = require_count("dwell_ticks", dwell_ticks, 0, self._history - 1)
            self._alpha = self.DeclareVectorInputPort("detector_alpha", 1)
            self._last_alphas = self.DeclareVectorInputPort("last_alphas", self._history)
            both = {self._alpha.ticket(), self._last_alphas.ticket()}
            self.DeclareVectorOutputPort("alpha", 1, self._calc_alpha, both)

        def _construct_copy(self, other, converter=None):
            Impl._construct(self, history=other._history, dwell_ticks=other._ticks, converter=converter)

        def _calc_alpha(self, context, output):
            alpha, last = self._alpha.Eval(context), self._last_alphas.Eval(context)
            fell = any(last[j] < GUARD <= last[j + 1] for j in range(self._ticks))
            output[0] = 0.0 * alpha[0] if fell else alpha[0]

    return Impl


DwellTime = DwellTime_[None]
