"""How near the arm, its hand and the can that it holds are to anything else: the truth, for scoring."""

import numpy as np
from pydrake.geometry import QueryObject, Role

from diagrams.world.names import CANS, FINGERS, IN_HAND
from diagrams.world.station import PickPlaceStation

ARM = ("arm", "gripper")  # models
WITHIN = 0.05  # m: farther away is not told apart


class ArmDistance:
    """The distance between arm, hand and held can on one side, and desk, shelf and cans on the other."""

    def __init__(self, station: PickPlaceStation, own: bool = False):
        """`own`: the can to pick is the arm's own, whatever becomes of it: nothing that it could touch."""
        plant = station.plant
        can = plant.GetBodyByName("can", plant.GetModelInstanceByName(CANS[0]))
        grasp = plant.GetFrameByName("grasp")
        self._can = plant.GetBodyFrameIdOrThrow(can.index())
        self._palm, self._X_PG = plant.GetBodyFrameIdOrThrow(grasp.body().index()), grasp.GetFixedPoseInBodyFrame()
        inspector = station.scene_graph.model_inspector()
        self._owner = {}  # names of model and body that a shape belongs to
        for shape in inspector.GetAllGeometryIds(Role.kProximity):
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
            self._owner[shape] = plant.GetModelInstanceName(body.model_instance()), body.name()
        self._fingers = {f"{side}_finger" for side in FINGERS}
        self._rest = {"desk", "shelf", *CANS[own:]}

    def nearest(self, query: QueryObject, closed: bool) -> tuple[float, str | None]:
        """The smallest distance, m, at most WITHIN, negative: so deep in each other; the model that is that near.

        `query`: of the station's port `query_object`; `closed`: whether the fingers are commanded so.
        """
        grasp, can = query.GetPoseInWorld(self._palm).multiply(self._X_PG), query.GetPoseInWorld(self._can)
        pairs = [
            (
                pair.distance,
                *sorted((self._owner[pair.id_A], self._owner[pair.id_B]), key=lambda owner: owner[0] not in ARM),
            )
            for pair in query.ComputeSignedDistancePairwiseClosestPoints(WITHIN)
        ]
        arm, rest = set(ARM), set(self._rest)
        fingers = {body for distance, (_, body), (model, _) in pairs if distance <= 0.0 and model == CANS[0]}
        between = np.linalg.norm(grasp.translation() - can.translation()) < IN_HAND
        if between or (closed and self._fingers <= fingers):  # it may have slid along them
            rest.discard(CANS[0])
            if closed:
                arm.add(CANS[0])
        nearest, name = WITHIN, None
        for distance, (a, _), (b, _) in pairs:
            a, b = (a, b) if a in arm else (b, a)
            if distance < nearest and a in arm and b in rest:
                nearest, name = float(distance), b
        return nearest, name
