"""How near the arm comes to anything on its ways home: the truth, for scoring."""

import numpy as np
from pydrake.geometry import Role
from pydrake.systems.framework import Context

from diagrams.world.names import CANS, IN_HAND
from diagrams.world.station import PickPlaceStation

WITHIN = 0.05  # m: farther away is not told apart


class WayHome:
    """The smallest distance between arm, hand and held can on one side, and desk, shelf and cans on the other."""

    def __init__(self, station: PickPlaceStation, own: bool = False):
        """`own`: the can to pick is the arm's own, whatever becomes of it: nothing that it could touch."""
        self._station, plant = station, station.plant
        self._can = plant.GetBodyByName("can", plant.GetModelInstanceByName(CANS[0]))
        self._grasp = plant.GetFrameByName("grasp")
        inspector = station.scene_graph.model_inspector()
        self._owner = {}  # name of the model that a shape belongs to
        for shape in inspector.GetAllGeometryIds(Role.kProximity):
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
            self._owner[shape] = plant.GetModelInstanceName(body.model_instance())
        self._rest = {"desk", "shelf", *CANS[own:]}
        self.nearest: float | None = None  # m, at most WITHIN; negative: so deep in each other; None: nothing seen yet
        self.name: str | None = None  # the model that was that near

    def see(self, root: Context, closed: bool) -> None:
        """Looks at the arm as it is in the root Context; `closed`: whether the fingers are commanded so."""
        station, arm = self._station, {"arm", "gripper"}
        context = station.plant.GetMyContextFromRoot(root)
        grasp, can = self._grasp.CalcPoseInWorld(context), station.plant.EvalBodyPoseInWorld(context, self._can)
        rest = set(self._rest)
        if np.linalg.norm(grasp.translation() - can.translation()) < IN_HAND:
            rest.discard(CANS[0])
            if closed:
                arm.add(CANS[0])
        query = station.GetOutputPort("query_object").Eval(station.GetMyContextFromRoot(root))
        self.nearest = WITHIN if self.nearest is None else self.nearest
        for pair in query.ComputeSignedDistancePairwiseClosestPoints(WITHIN):
            a, b = self._owner[pair.id_A], self._owner[pair.id_B]
            a, b = (a, b) if a in arm else (b, a)
            if pair.distance < self.nearest and a in arm and b in rest:
                self.nearest, self.name = float(pair.distance), b
