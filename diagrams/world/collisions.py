"""CollisionChecker: does a straight joint motion of the arm, with or without the can in its hand, touch the scene?"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from pydrake.geometry import Role
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from diagrams.world.configuration import World
from diagrams.world.names import CAN_HALF_HEIGHT, CAN_RADIUS, CANS, other_spot
from diagrams.world.station import add_models, can_body, spot_centre

LEAST_SAMPLES = 24  # of a path
SPACING = np.deg2rad(1.0)  # of the joint that moves most, between two samples
GRASPED_BELOW = 0.010  # m: the hand holds the can by so much above its middle
# Of the held can, upright where the hand points down: the grasp frame's z points out of the hand.
X_GRASP_CAN = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0.0, 0.0, GRASPED_BELOW])


class CollisionChecker:
    """Distances between the arm (and what it holds) and everything else, by Drake's signed-distance queries."""

    def __init__(self, gap: float = 0.01, rigid_grasp: bool = False):
        """`gap`: what comes nearer than this (m) counts as touching.

        `rigid_grasp`: a held can turns with the hand, X_GRASP_CAN, however that leans; else its middle stays below the
        grasp frame, as where the hand points downwards: see `first_touch`.
        """
        builder = DiagramBuilder()
        self._plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        add_models(self._plant)
        self._plant.Finalize()
        diagram = builder.Build()
        self._context = diagram.CreateDefaultContext()
        self._plant_context = self._plant.GetMyMutableContextFromRoot(self._context)
        self._query = lambda: scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(self._context))
        self._gap, self._rigid_grasp = gap, rigid_grasp
        self._arm, self._gripper = map(self._plant.GetModelInstanceByName, ("arm", "gripper"))
        inspector = scene_graph.model_inspector()
        self._owner = {}  # name of the model that a shape belongs to
        for shape in inspector.GetAllGeometryIds(Role.kProximity):
            body = self._plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
            self._owner[shape] = self._plant.GetModelInstanceName(body.model_instance())

    def _place(self, can: str, X_WC: RigidTransform) -> None:
        self._plant.SetFloatingBaseBodyPoseInWorldFrame(self._plant_context, can_body(self._plant, can), X_WC)

    def set_scene(
        self, can_xy: np.ndarray | tuple[float, float] | None, vacant: str, opening: float = World().opening
    ) -> None:
        """Where the cans stand; `can_xy` (2, m, world) or None: the can is in the hand, the fingers closed on it.

        `opening`: of the fingers of the empty hand, m.
        """
        self._held = can_xy is None
        gap = 2 * CAN_RADIUS if self._held else opening
        self._plant.SetPositions(self._plant_context, self._gripper, [0.5 * gap, 0.5 * gap])
        self._place(CANS[1], RigidTransform(self.spot(other_spot(vacant))))
        if can_xy is not None:
            self._place(CANS[0], RigidTransform([*can_xy, CAN_HALF_HEIGHT]))

    def spot(self, name: str) -> np.ndarray:
        """See `spot_centre`."""
        return spot_centre(self._plant, name)

    def first_touch(self, joints: np.ndarray) -> str | None:
        """Name of a model that the arm at `joints` (7, rad), or the can that it holds, touches; None if clear."""
        return next((name for _, name in self._near(joints)), None)

    def _near(self, joints: np.ndarray) -> Iterator[tuple[float, str]]:
        """What is nearer than the gap to the arm at `joints`, or to the can that it holds: distance (m), model."""
        self._plant.SetPositions(self._plant_context, self._arm, joints)
        moving = {"arm", "gripper"}
        if self._held:
            X_WG = self._plant.GetFrameByName("grasp").CalcPoseInWorld(self._plant_context)
            # The hand holds the can a little above its middle, upright when the hand leans as in the demonstrations.
            below = RigidTransform(X_WG.rotation(), X_WG.translation() - [0, 0, GRASPED_BELOW])
            self._place(CANS[0], X_WG.multiply(X_GRASP_CAN) if self._rigid_grasp else below)
            moving.add(CANS[0])
        for pair in self._query().ComputeSignedDistancePairwiseClosestPoints(self._gap):
            a, b = self._owner[pair.id_A], self._owner[pair.id_B]
            if (a in moving) != (b in moving):
                yield pair.distance, b if a in moving else a

    def path_touches(self, start: np.ndarray, goal: np.ndarray) -> str | None:
        """The first model touched on the straight path from `start` to `goal` (7 each, rad); None if clear."""
        samples = max(LEAST_SAMPLES, 1 + int(np.ceil(np.abs(goal - start).max() / SPACING)))
        for share in np.linspace(0.0, 1.0, samples):
            if (name := self.first_touch((1 - share) * start + share * goal)) is not None:
                return name
        return None

    def nearest_on(self, rows: np.ndarray) -> tuple[float, str | None]:
        """Smallest distance, m, and to which model, on the way through `rows` (n, 7, rad), each straight to the next.

        Where nothing is nearer than the gap: the gap, and None. Cans stand where `set_scene` stood them.
        """
        parts = [rows[:1]]
        for start, goal in pairwise(rows):
            count = max(1, int(np.ceil(np.abs(goal - start).max() / SPACING)))
            parts.append(start + np.arange(1, count + 1)[:, None] / count * (goal - start))
        found = (near for joints in np.concatenate(parts) for near in self._near(joints))
        return min(found, default=(self._gap, None), key=lambda near: near[0])
