"""How near the arm comes to anything on its ways home: the truth, for scoring."""

import numpy as np
from pydrake.geometry import Role
from pydrake.systems.framework import Context

from diagrams.world.names import CANS, FINGERS, IN_HAND
from diagrams.world.station import PickPlaceStation

ARM = ("arm", "gripper")  # models
WITHIN = 0.05  # m: farther away is not told apart


class WayHome:
    """The smallest distance between arm, hand and held can on one side, and desk, shelf and cans on the other."""

    def __init__(self, station: PickPlaceStation, own: bool = False):
        """`own`: the can to pick is the arm's own, whatever becomes of it: nothing that it could touch."""
        self._station, plant = station, station.plant
        self._can = plant.GetBodyByName("can", plant.GetModelInstanceByName(CANS[0]))
        self._grasp = plant.GetFrameByName("grasp")
        inspector = station.scene_graph.model_inspector()
        self._owner = {}  # names of model and body that a shape belongs to
        for shape in inspector.GetAllGeometryIds(Role.kProximity):
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
            self._owner[shape] = plant.GetModelInstanceName(body.model_instance()), body.name()
        self._fingers = {f"{side}_finger" for side in FINGERS}
        self._rest = {"desk", "shelf", *CANS[own:]}
        self.nearest: float | None = None  # m, at most WITHIN; negative: so deep in each other; None: nothing seen yet
        self.name: str | None = None  # the model that was that near

    def see(self, root: Context, closed: bool) -> None:
        """Looks at the arm as it is in the root Context; `closed`: whether the fingers are commanded so."""
        station, arm = self._station, set(ARM)
        context = station.plant.GetMyContextFromRoot(root)
        grasp, can = self._grasp.CalcPoseInWorld(context), station.plant.EvalBodyPoseInWorld(context, self._can)
        query = station.GetOutputPort("query_object").Eval(station.GetMyContextFromRoot(root))
        pairs = [
            (
                pair.distance,
                *sorted((self._owner[pair.id_A], self._owner[pair.id_B]), key=lambda owner: owner[0] not in ARM),
            )
            for pair in query.ComputeSignedDistancePairwiseClosestPoints(WITHIN)
        ]
        rest = set(self._rest)
        fingers = {body for distance, (_, body), (model, _) in pairs if distance <= 0.0 and model == CANS[0]}
        between = np.linalg.norm(grasp.translation() - can.translation()) < IN_HAND
        if between or (closed and self._fingers <= fingers):  # it may have slid along them
            rest.discard(CANS[0])
            if closed:
                arm.add(CANS[0])
        self.nearest = WITHIN if self.nearest is None else self.nearest
        for distance, (a, _), (b, _) in pairs:
            a, b = (a, b) if a in arm else (b, a)
            if distance < self.nearest and a in arm and b in rest:
                self.nearest, self.name = float(distance), b
