"""CollisionChecker: does a straight joint motion of the arm, with or without the can in its hand, touch the scene?"""

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Role
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from diagrams.world.configuration import World
from diagrams.world.names import CAN_HALF_HEIGHT, CAN_RADIUS, CANS, other_spot
from diagrams.world.station import add_models, can_body, spot_centre
from diagrams.world.trajectory import X_GRASP_CAN

LEAST_SAMPLES = 24  # of a path
SPACING = np.deg2rad(1.0)  # of the joint that moves most, between two samples


class CollisionChecker:
    """Distances between the arm (and what it holds) and everything else, by Drake's signed-distance queries."""

    def __init__(self, world: World, gap: float = 0.01):
        """The models of `world`; `gap`: what comes nearer than this (m) counts as touching."""
        builder = DiagramBuilder()
        self._plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        add_models(self._plant, world)
        self._plant.Finalize()
        diagram = builder.Build()
        self._context = diagram.CreateDefaultContext()
        self._plant_context = self._plant.GetMyMutableContextFromRoot(self._context)
        self._query = lambda: scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(self._context))
        self._gap, self._opening = gap, world.opening
        self._arm, self._gripper = map(self._plant.GetModelInstanceByName, ("arm", "gripper"))
        inspector = scene_graph.model_inspector()
        self._owner = {}  # name of the model that a shape belongs to
        for shape in inspector.GetAllGeometryIds(Role.kProximity):
            body = self._plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
            self._owner[shape] = self._plant.GetModelInstanceName(body.model_instance())

    def _place(self, can: str, X_WC: RigidTransform) -> None:
        self._plant.SetFloatingBaseBodyPoseInWorldFrame(self._plant_context, can_body(self._plant, can), X_WC)

    def set_scene(
        self, can_xy: np.ndarray | tuple[float, float] | None, vacant: str, opening: float | None = None
    ) -> None:
        """Where the cans stand; `can_xy` (2, m, world) or None: the can is in the hand, the fingers closed on it.

        `opening`: of the fingers of the empty hand, m; None: they are open.
        """
        self._held = can_xy is None
        gap = 2 * CAN_RADIUS if self._held else self._opening if opening is None else opening
        self._plant.SetPositions(self._plant_context, self._gripper, [0.5 * gap, 0.5 * gap])
        self._place(CANS[1], RigidTransform(self.spot(other_spot(vacant))))
        if can_xy is not None:
            self._place(CANS[0], RigidTransform([*can_xy, CAN_HALF_HEIGHT]))

    def set_poses(self, can_poses: np.ndarray, held: bool) -> None:
        """Where the cans are, (14,) as PickPlaceStation gives them; `held`: but the one to pick is in the hand."""
        self._held = held
        gap = 2 * CAN_RADIUS if held else self._opening
        self._plant.SetPositions(self._plant_context, self._gripper, [0.5 * gap, 0.5 * gap])
        for can, pose in zip(CANS, can_poses.reshape(len(CANS), 7), strict=True):
            self._place(can, RigidTransform(Quaternion(pose[:4] / np.linalg.norm(pose[:4])), pose[4:]))

    def spot(self, name: str) -> np.ndarray:
        """See `spot_centre`."""
        return spot_centre(self._plant, name)

    def first_touch(self, joints: np.ndarray) -> str | None:
        """Name of a model that the arm at `joints` (7, rad), or the can that it holds, touches; None if clear."""
        self._plant.SetPositions(self._plant_context, self._arm, joints)
        moving = {"arm", "gripper"}
        if self._held:
            X_WG = self._plant.GetFrameByName("grasp").CalcPoseInWorld(self._plant_context)
            self._place(CANS[0], X_WG.multiply(X_GRASP_CAN))
            moving.add(CANS[0])
        for pair in self._query().ComputeSignedDistancePairwiseClosestPoints(self._gap):
            a, b = self._owner[pair.id_A], self._owner[pair.id_B]
            if (a in moving) != (b in moving):
                return b if a in moving else a
        return None

    def path_touches(self, start: np.ndarray, goal: np.ndarray) -> str | None:
        """The first model touched on the straight path from `start` to `goal` (7 each, rad); None if clear."""
        samples = max(LEAST_SAMPLES, 1 + int(np.ceil(np.abs(goal - start).max() / SPACING)))
        for share in np.linspace(0.0, 1.0, samples):
            if (name := self.first_touch((1 - share) * start + share * goal)) is not None:
                return name
        return None
