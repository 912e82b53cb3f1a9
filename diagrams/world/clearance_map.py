"""What the arm knows of its surroundings on its way home: desk, shelf, and the cans."""

import itertools
import logging

import numpy as np
from pydrake.geometry import (
    Box,
    Capsule,
    CollisionFilterDeclaration,
    Cylinder,
    GeometryId,
    GeometrySet,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame, RigidBody, SpatialInertia
from pydrake.planning import (
    LinearDistanceAndInterpolationProvider,
    RobotClearance,
    RobotDiagramBuilder,
    SceneGraphCollisionChecker,
)
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import ZeroOrderHold

from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT, CAN_RADIUS, CANS, IN_HAND, LIMIT_MARGIN, SPOTS
from diagrams.world.station import PickPlaceStation, add_models, controller_limits
from diagrams.world.trajectory import X_GRASP_CAN
from models.errors import InputError
from systems.clearance_filter import WITHIN, ClearanceFilter, Near

HELD = "held_can"
FOOT = ("base", "link_1")  # of the arm, which the hand could meet
CELLS = 4  # a side, of the trained area: a can may stand in each
HAND = ("palm", "left_finger", "right_finger")
POSE = 7  # numbers of a can's pose: quaternion (w, x, y, z) and position, m, world


class _Scene:
    """Arm, hand, desk, shelf and cans, for Drake's distances; `held`: with a can in the hand."""

    def __init__(self, world: World, held: bool, possible: bool):
        """`possible`: a can wherever one may stand; else the cans that are not in the hand, where they are told."""
        builder = RobotDiagramBuilder(time_step=0.0)
        plant = builder.plant()
        add_models(plant, world, ("desk", "shelf", "arm", "gripper"))
        can = Cylinder(CAN_RADIUS, 2 * CAN_HALF_HEIGHT)
        hand = ["arm", "gripper"]
        if held:
            hand.append(HELD)
            _add(plant, HELD, can, plant.GetFrameByName("grasp"), X_GRASP_CAN)
        self.cans: dict[str, RigidBody] = {}
        if possible:
            lower, upper = world.grid.bounds
            side = (upper - lower) / CELLS
            cell = Box(*(side + 2 * CAN_RADIUS), 2 * CAN_HALF_HEIGHT)
            for i, j in np.ndindex(CELLS, CELLS):
                centre = RigidTransform([*(lower + side * (np.array([i, j]) + 0.5)), CAN_HALF_HEIGHT])
                self.cans[f"cell_{i}_{j}"] = _add(plant, f"cell_{i}_{j}", cell, plant.world_frame(), centre)
            for spot in SPOTS:
                X_SC = RigidTransform([0, 0, CAN_HALF_HEIGHT])
                self.cans[spot] = _add(plant, f"{spot}_can", can, plant.GetFrameByName(f"{spot}_spot"), X_SC)
        else:
            self.cans = {name: _add(plant, name, can) for name in (CANS[1:] if held else CANS)}
        for name in FOOT:  # they have no shapes for the physics, which nothing but the hand could touch: those drawn
            _shape_as_drawn(plant, builder.scene_graph(), plant.GetBodyByName(name))
        plant.Finalize()
        self.arm = [plant.GetModelInstanceByName(name) for name in hand]
        self._exclude(builder, plant)
        model = builder.Build()
        logging.getLogger("drake").setLevel(logging.WARNING)  # the checker tells how many contexts it allocates
        self.checker = SceneGraphCollisionChecker(
            model=model,
            robot_model_instances=self.arm,
            edge_step_size=1.0,  # of checks of edges, which nobody asks for
            env_collision_padding=0.0,
            self_collision_padding=0.0,
            distance_and_interpolation_provider=LinearDistanceAndInterpolationProvider(model.plant()),
        )
        self.plant = plant
        self.positions = plant.GetPositions(plant.CreateDefaultContext())
        self.bodies = np.array([int(body.index()) for body in self.cans.values()])
        # What the learned motion must come near to: the hand to the can that it picks, the held can to where it goes.
        goals = [body for name, body in self.cans.items() if possible or name == CANS[0]]
        self.goals = np.array([int(body.index()) for body in goals], int)
        self.hand = np.array([int(plant.GetBodyByName(name).index()) for name in HAND])
        self.foot = np.array([int(plant.GetBodyByName(name).index()) for name in FOOT])
        self.held = int(plant.GetBodyByName(HELD).index()) if held else None
        self.slip = world.clearance.slip

    def _exclude(self, builder: RobotDiagramBuilder, plant: MultibodyPlant) -> None:
        """Leaves out the pairs within the rest, and those within the arm that no joint angles let meet."""
        arm, rest, foot, hand = list[GeometryId](), list[GeometryId](), list[GeometryId](), list[GeometryId]()
        for index in range(plant.num_bodies()):
            body = plant.get_body(BodyIndex(index))
            shapes = plant.GetCollisionGeometriesForBody(body)
            on_foot, on_hand = body.name() in FOOT, body.name() in (*HAND, HELD)
            (foot if on_foot else arm if body.model_instance() in self.arm else rest).extend(shapes)
            hand.extend(shapes if on_hand else [])
        links = [shape for shape in arm if shape not in hand]
        filters = builder.scene_graph().collision_filter_manager()
        for side in (arm, rest, foot):
            filters.Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(side)))
        for other in (links, rest):
            filters.Apply(CollisionFilterDeclaration().ExcludeBetween(GeometrySet(foot), GeometrySet(other)))

    def reach(self) -> np.ndarray:
        """(J,) m/rad: see `systems.clearance_filter.Map`."""
        plant, context = self.plant, self.plant.CreateDefaultContext()
        plant.SetPositions(context, plant.GetModelInstanceByName("gripper"), plant.GetPositionUpperLimits()[7:9])
        inspector = self.checker.model().scene_graph().model_inspector()
        links = [plant.GetBodyByName(f"link_{j + 1}") for j in range(ARM_JOINTS)]
        origins = [plant.EvalBodyPoseInWorld(context, link).translation() for link in links]
        extents = np.zeros(ARM_JOINTS)
        for index in range(plant.num_bodies()):
            body = plant.get_body(BodyIndex(index))
            if body.model_instance() not in self.arm or body.name() in FOOT:
                continue
            j = links.index(body) if body in links else ARM_JOINTS - 1
            X_WB = plant.EvalBodyPoseInWorld(context, body)
            for shape in plant.GetCollisionGeometriesForBody(body):
                centre = X_WB.multiply(inspector.GetPoseInFrame(shape).translation())
                extents[j] = max(extents[j], np.linalg.norm(centre - origins[j]) + _radius(inspector.GetShape(shape)))
        spans = [np.linalg.norm(b - a) for a, b in itertools.pairwise(origins)]
        for j in reversed(range(ARM_JOINTS - 1)):
            extents[j] = max(extents[j], spans[j] + extents[j + 1])
        return extents


class ClearanceMap:
    """Distances of the arm and of what it holds to desk, shelf and cans: see `systems.clearance_filter.Map`.

    A can is in the hand where the fingers are commanded closed; it is not known whether they hold one. With `possible`,
    a can may stand on either spot of the shelf and in each cell of the trained area of the desk; but none in a cell, or
    on a spot, where one would overlap the arm as it is (so a can of that cell that would not is overlooked). Else the
    cans are where `obstacles` says: (14,) `can_poses` of the station, the truth, as they were at the tick. Of the arm's
    own pairs hand and held can against base and link 1 are in it; no joint angles that it allows let others meet.
    """

    def __init__(self, world: World, possible: bool = True):
        """`possible`: a can wherever one may stand, instead of the truth."""
        self._world, self._possible = world, possible
        self.obstacle_size = 0 if possible else POSE * len(CANS)
        self._scenes = [_Scene(world, held, possible) for held in (False, True)]
        self._context = self._scenes[False].plant.CreateDefaultContext()  # scratch
        self.reach = self._scenes[True].reach()

    def view(self, posture: np.ndarray, obstacles: np.ndarray, returning: bool = True) -> "_View":
        """What is there with the arm at `posture` (8, rad and m); `obstacles`: (0,) or (14,), see the class.

        Not `returning`, a held can may come near to everything, and the hand to the can that it picks: to every
        possible one.
        """
        closed = bool(posture[ARM_JOINTS] < self._world.close_below)
        if self._possible:
            return _View(self._scenes[closed], posture, 2 * CAN_RADIUS if closed else posture[ARM_JOINTS], returning)
        poses = dict(zip(CANS, obstacles.reshape(len(CANS), POSE), strict=True))
        scene = self._scenes[closed and self._in_hand(posture, poses[CANS[0]])]
        return _View(scene, posture, 2 * CAN_RADIUS if closed else posture[ARM_JOINTS], returning, poses)

    def from_foot(self, posture: np.ndarray) -> float:
        """Hand and held can to the arm's own base and link 1, at `posture` (8, rad and m): m, at most WITHIN.

        Of a map with `possible`.
        """
        return self.view(posture, np.empty(0)).from_foot(posture[:ARM_JOINTS])

    def _in_hand(self, posture: np.ndarray, pose: np.ndarray) -> bool:
        plant, context = self._scenes[False].plant, self._context
        plant.SetPositions(context, plant.GetModelInstanceByName("arm"), posture[:ARM_JOINTS])
        grasp = plant.GetFrameByName("grasp").CalcPoseInWorld(context).translation()
        return bool(np.linalg.norm(grasp - pose[4:]) < IN_HAND)


def clearance_filter(world: World, station: PickPlaceStation) -> ClearanceFilter | None:
    """The filter that `world.clearance` asks for; None: the way home is straight.

    Raises InputError where the arm at its initial posture is nearer than the gap to something.
    """
    given = world.clearance
    if given.cans == "unseen":
        return None
    lower, upper, speed = controller_limits(station)
    map = ClearanceMap(world, possible=given.cans == "possible")
    anywhere = map if given.cans == "possible" else ClearanceMap(world)
    for opening in (world.opening, world.closed_opening):
        home = np.append(world.initial_posture[:ARM_JOINTS], opening)
        near = anywhere.view(home, np.empty(0)).near(home[:ARM_JOINTS], WITHIN)
        nearest = (near.distances - near.margins).min(initial=WITHIN)
        if nearest <= given.gap:
            raise InputError(
                f"world.clearance.gap {given.gap} m: at the initial posture the arm, or a can that has slid by "
                f"{given.slip} m in the hand, may be {nearest:.3f} m from desk, shelf, or where a can may stand, and "
                "could not come home: choose less, or another posture"
            )
    # A changed step stays where A's targets may be, and a degree within: the servo may overshoot.
    margin = np.append(np.full(ARM_JOINTS, LIMIT_MARGIN + np.deg2rad(1.0)), np.zeros(len(lower) - ARM_JOINTS))
    return ClearanceFilter(
        map,
        posture_size=len(lower),
        joints=ARM_JOINTS,
        lower=lower + margin,
        upper=upper - margin,
        max_step=(speed * world.timing.period)[:ARM_JOINTS],
        gap=given.gap,
        least=given.least,
        rate=given.rate,
        learned_motion=given.learned_motion,
    )


def add_clearance_filter(
    builder: DiagramBuilder,
    world: World,
    station: PickPlaceStation,
    posture: OutputPort,
    alpha: OutputPort,
    command: OutputPort,
) -> OutputPort:
    """Puts the filter that `world.clearance` asks for behind `command`; the port that the arm is to follow.

    `posture`: as sampled at the tick. Raises InputError as `clearance_filter` does.
    """
    system = clearance_filter(world, station)
    if system is None:
        return command
    builder.AddNamedSystem("clearance_filter", system)
    for name, port in (("posture", posture), ("alpha", alpha), ("desired_posture", command)):
        builder.Connect(port, system.GetInputPort(name))
    if system.HasInputPort("obstacles"):  # held, so that they are those of the tick, as the posture is
        size = system.GetInputPort("obstacles").size()
        hold = builder.AddNamedSystem("obstacles_hold", ZeroOrderHold(world.timing.period, size))
        builder.Connect(station.GetOutputPort("can_poses"), hold.get_input_port())
        builder.Connect(hold.get_output_port(), system.GetInputPort("obstacles"))
    return system.GetOutputPort("filtered_posture")


def tell_of_cans(diagram: Diagram, root: Context, station: PickPlaceStation) -> None:
    """Tells the filter in `diagram`, if it has one that is told, where the cans stand in the root Context.

    For its beginning: before the first tick nothing has told it.
    """
    if diagram.HasSubsystemNamed("obstacles_hold"):
        hold = diagram.GetSubsystemByName("obstacles_hold")
        poses = station.GetOutputPort("can_poses").Eval(station.GetMyContextFromRoot(root))
        hold.SetVectorState(hold.GetMyMutableContextFromRoot(root), poses)


class _View:
    """The scene as it is known at one posture."""

    def __init__(
        self,
        scene: _Scene,
        posture: np.ndarray,
        gap: float,
        returning: bool,
        poses: dict[str, np.ndarray] | None = None,
    ):
        """`gap`: of the fingers, m; `poses`: (7,) each, of the cans."""
        self._scene, self._returning, self._absent = scene, returning, np.empty(0, int)
        self._positions = scene.positions.copy()
        self._positions[ARM_JOINTS : ARM_JOINTS + 2] = 0.5 * gap
        for name, pose in (poses or {}).items():
            if name in scene.cans:
                start = scene.cans[name].floating_positions_start()
                self._positions[start : start + POSE] = pose
        if poses is None and self._clearance(posture[:ARM_JOINTS], 0.0).size():
            found = self._query(posture[:ARM_JOINTS], 0.0)
            overlapped = found.pairs[found.distances < 0.0] % scene.plant.num_bodies()
            self._absent = np.intersect1d(overlapped, scene.bodies)

    def _clearance(self, joints: np.ndarray, within: float) -> RobotClearance:
        self._positions[:ARM_JOINTS] = joints
        return self._scene.checker.CalcRobotClearance(self._positions, within)

    def _query(self, joints: np.ndarray, within: float) -> Near:
        scene, found = self._scene, self._clearance(joints, within)
        robot, other = (
            np.array([int(i) for i in side], int) for side in (found.robot_indices(), found.other_indices())
        )
        jacobians = np.reshape(found.jacobians(), (len(robot), len(self._positions)))[:, :ARM_JOINTS]
        margins = scene.slip * (robot == scene.held)
        return Near(found.distances(), jacobians, scene.plant.num_bodies() * robot + other, margins)

    def near(self, joints: np.ndarray, within: float) -> Near:
        """See `systems.clearance_filter.View`."""
        scene, found = self._scene, self._query(joints, within)
        robot, other = np.divmod(found.pairs, scene.plant.num_bodies())
        there = ~np.isin(other, self._absent)
        if not self._returning:
            there &= ~(np.isin(robot, scene.hand) & np.isin(other, scene.goals)) & (robot != scene.held)
        return Near(*(values[there] for values in vars(found).values()))

    def from_foot(self, joints: np.ndarray) -> float:
        """See `ClearanceMap`."""
        found = self._query(joints, WITHIN)
        pairs = np.array(np.divmod(found.pairs, self._scene.plant.num_bodies()))
        return float(found.distances[np.isin(pairs, self._scene.foot).any(axis=0)].min(initial=WITHIN))

    def nearest(self, joints: np.ndarray, within: float, but: np.ndarray) -> float:
        """See `systems.clearance_filter.View`."""
        if self._returning and not len(self._absent) and not len(but):  # to number the pairs takes as long as all else
            return float(self._clearance(joints, within).distances().min(initial=within))
        near = self.near(joints, within)
        return float(near.distances[~np.isin(near.pairs, but)].min(initial=within))


def _add(
    plant: MultibodyPlant, name: str, shape: Shape, frame: Frame | None = None, X_FB: RigidTransform | None = None
) -> RigidBody:
    """A body of that shape, a model of its own, welded to `frame` at `X_FB`; free without one."""
    body = plant.AddRigidBody(name, plant.AddModelInstance(name), SpatialInertia.SolidSphereWithMass(1.0, 0.05))
    plant.RegisterCollisionGeometry(body, RigidTransform(), shape, name, CoulombFriction(1.0, 1.0))
    if frame is not None:
        plant.WeldFrames(frame, body.body_frame(), X_FB)
    return body


def _shape_as_drawn(plant: MultibodyPlant, scene_graph: SceneGraph, body: RigidBody) -> None:
    """Gives `body` the shapes that are drawn of it."""
    inspector = scene_graph.model_inspector()
    for drawn in plant.GetVisualGeometriesForBody(body):
        shape, X_BS = inspector.GetShape(drawn), inspector.GetPoseInFrame(drawn)
        plant.RegisterCollisionGeometry(body, X_BS, shape, inspector.GetName(drawn), CoulombFriction(1.0, 1.0))


def _radius(shape: Shape) -> float:
    """Of a ball about the shape's centre that holds it, m."""
    match shape:
        case Sphere():
            return shape.radius()
        case Capsule():
            return shape.radius() + 0.5 * shape.length()
        case Cylinder():
            return float(np.hypot(shape.radius(), 0.5 * shape.length()))
        case Box():
            return 0.5 * float(np.linalg.norm(shape.size()))
    raise NotImplementedError(f"no ball about a {type(shape).__name__}: add its radius to _radius")
