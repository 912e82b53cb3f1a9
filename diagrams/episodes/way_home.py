"""How near the arm comes to anything on its ways home: the truth, for scoring."""

from pydrake.systems.framework import Context

from diagrams.world.arm_distance import WITHIN, ArmDistance
from diagrams.world.station import PickPlaceStation


class WayHome:
    """The smallest distance of an ArmDistance that was seen."""

    def __init__(self, station: PickPlaceStation, own: bool = False):
        """`own`: see ArmDistance."""
        self._station, self._distance = station, ArmDistance(station, own)
        self.nearest: float | None = None  # m, at most WITHIN; negative: so deep in each other; None: nothing seen yet
        self.name: str | None = None  # the model that was that near

    def see(self, root: Context, closed: bool) -> None:
        """Looks at the arm as it is in the root Context; `closed`: whether the fingers are commanded so."""
        query = self._station.GetOutputPort("query_object").Eval(self._station.GetMyContextFromRoot(root))
        distance, name = self._distance.nearest(query, closed)
        self.nearest = WITHIN if self.nearest is None else self.nearest
        if distance < self.nearest:
            self.nearest, self.name = distance, name
