"""ClearanceMeter: how near the arm came to anything on its way home, at the ticks."""

from pydrake.common.value import Value
from pydrake.geometry import QueryObject
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from diagrams.world.arm_distance import WITHIN, ArmDistance
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS
from diagrams.world.station import PickPlaceStation
from systems.detector import GUARD


class ClearanceMeter(LeafSystem):
    """Measures the truth, for requirements and scoring, never for the controller.

    .. pydrake_system::

        name: ClearanceMeter
        input_ports:
        - query_object
        - alpha
        - active
        - posture
        output_ports:
        - clearance

    - `query_object`: the station's port of that name.
    - `alpha` (1): alpha_k, held; `active` (1): above 1/2 while the arm is disturbed.
    - `posture` (8): m_k, rad and m; the last is the commanded gap of the fingers.
    - `clearance` (1), m: see ArmDistance. As it is at the tick, where the arm was on a way home in the tick before
      (alpha >= 1/2, not disturbed); else WITHIN. Discrete state: constant between ticks.
    """

    def __init__(self, world: World, station: PickPlaceStation):
        super().__init__()
        self._distance, self._close_below = ArmDistance(station), world.close_below
        self._query = self.DeclareAbstractInputPort("query_object", Value[QueryObject]())
        self._alpha = self.DeclareVectorInputPort("alpha", 1)
        self._active = self.DeclareVectorInputPort("active", 1)
        self._posture = self.DeclareVectorInputPort("posture", ARM_JOINTS + 1)
        self._clearance = self.DeclareDiscreteState([WITHIN])
        self.DeclareStateOutputPort("clearance", self._clearance)
        self.DeclarePeriodicDiscreteUpdateEvent(world.timing.period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        distance = WITHIN
        if self._alpha.Eval(context)[0] >= GUARD and self._active.Eval(context)[0] < 0.5:
            closed = bool(self._posture.Eval(context)[ARM_JOINTS] < self._close_below)
            distance, _ = self._distance.nearest(self._query.Eval(context), closed)
        discrete_state.set_value(self._clearance, [distance])
