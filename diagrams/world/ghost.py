"""What the network imagines, in the 3-D view: a ghost of the arm, a trail of what it recalls, a collar for alpha."""

import numpy as np
from pydrake.geometry import (
    Cylinder,
    MakePhongIllustrationProperties,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
    Role,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem, System
from pydrake.systems.primitives import AffineSystem
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS
from diagrams.world.station import add_models

MODELS = ("arm", "gripper")
TRANSLUCENT = (0.17, 0.42, 0.95, 0.35)  # red, green, blue, opacity
RECALLED = Rgba(0.55, 0.20, 0.75, 0.75)
BEAD = 0.006  # m, radius
COLLAR = Cylinder(0.075, 0.05)  # around the foot of the arm
LEVELS = 11  # of the collar's colour, green at alpha = 0, red at 1


def add_ghost(builder: DiagramBuilder, meshcat: Meshcat, world: World, controller: System, scaling) -> None:
    """Adds to `builder` what shows in `meshcat` what `controller`, a SwitchedController, imagines and recalls.

    The translucent arm stands where the network predicted the arm to be now; the beads are where, as it recalls, the
    hand was. The foot of the arm is green at alpha = 0 and red at 1. All of it only looks: no state, and nothing
    depends on it. `scaling`: of the policy.
    """
    plant, scene = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene)
    add_models(plant, world, MODELS)
    plant.Finalize()
    inspector, source = scene.model_inspector(), plant.get_source_id()
    properties = MakePhongIllustrationProperties(np.array(TRANSLUCENT))
    for shape in inspector.GetAllGeometryIds(Role.kIllustration):
        scene.RemoveRole(source, shape, Role.kIllustration)
        scene.AssignRole(source, shape, properties)
    builder.AddNamedSystem("ghost_scene", scene)
    recalled = controller.GetOutputPort("recalled_postures")
    size = len(scaling.centre)
    # Row 0, m^R, scaled: the joints, and half of the opening for each of the two fingers.
    take = np.vstack([np.eye(size)[:ARM_JOINTS], 0.5 * np.eye(size)[-1:], 0.5 * np.eye(size)[-1:]])
    D = np.hstack([take * scaling.half_range, np.zeros((len(take), recalled.size() - size))])
    positions = builder.AddNamedSystem("ghost_positions", AffineSystem(D=D, y0=take @ scaling.centre))
    poses = builder.AddNamedSystem("ghost_poses", MultibodyPositionToGeometryPose(plant))
    builder.Connect(recalled, positions.get_input_port())
    builder.Connect(positions.get_output_port(), poses.get_input_port())
    builder.Connect(poses.get_output_port(), scene.get_source_pose_port(source))
    params = MeshcatVisualizerParams(prefix="ghost", publish_period=world.timing.period)
    shown = MeshcatVisualizer(meshcat, params)
    builder.AddNamedSystem("ghost_view", shown)
    builder.Connect(scene.get_query_output_port(), shown.query_object_input_port())
    trail = builder.AddNamedSystem("recall_trail", RecallTrail(meshcat, plant, recalled.size(), scaling, world))
    builder.Connect(recalled, trail.GetInputPort("recalled_postures"))
    builder.Connect(controller.GetOutputPort("alpha"), trail.GetInputPort("alpha"))


class RecallTrail(LeafSystem):
    """Shows in Meshcat where the network recalls the hand to have been, and alpha on the arm's foot, once a tick.

    .. pydrake_system::

        name: RecallTrail
        input_ports:
        - recalled_postures
        - alpha

    - `recalled_postures` ((N + 1) M), scaled: see SwitchedController; row 0, the prediction, is not drawn.
    - `alpha` (1): in [0, 1].
    """

    def __init__(self, meshcat: Meshcat, plant: MultibodyPlant, size: int, scaling, world: World):
        """`plant`: of the arm and its gripper; `size`: of the recalled postures; `scaling`: of the policy."""
        super().__init__()
        self._meshcat, self._plant, self._scaling = meshcat, plant, scaling
        self._grasp, self._arm = plant.GetFrameByName("grasp"), plant.GetModelInstanceByName("arm")
        self._kinematics = plant.CreateDefaultContext()
        self._recalled = self.DeclareVectorInputPort("recalled_postures", size)
        self._alpha = self.DeclareVectorInputPort("alpha", 1)
        foot = plant.GetBodyByName("base").EvalPoseInWorld(self._kinematics)
        for n in range(1, size // len(scaling.centre)):
            meshcat.SetObject(self._bead(n), Sphere(BEAD), RECALLED)
        for level in range(LEVELS):
            share = level / (LEVELS - 1)
            colour = Rgba(min(1.0, 2 * share), 0.75 * min(1.0, 2 - 2 * share), 0.1, 1.0)
            meshcat.SetObject(self._collar(level), COLLAR, colour)
            meshcat.SetTransform(self._collar(level), foot @ RigidTransform([0, 0, 0.5 * COLLAR.length()]))
            meshcat.SetProperty(self._collar(level), "visible", level == 0)
        self.DeclarePeriodicPublishEvent(world.timing.period, 0.0, self._show)
        self.DeclareForcedPublishEvent(self._show)

    @staticmethod
    def _bead(n: int) -> str:
        return f"recall/{n}"

    @staticmethod
    def _collar(level: int) -> str:
        return f"alpha/{level}"

    def _show(self, context: Context) -> None:
        seconds, size = context.get_time(), len(self._scaling.centre)
        rows = self._recalled.Eval(context).reshape(-1, size)[1:]
        for n, row in enumerate(rows, 1):
            joints = self._scaling.unscale(row)[:ARM_JOINTS]
            # A scratch pad of the kinematics: what it holds before and after means nothing.
            self._plant.SetPositions(self._kinematics, self._arm, joints)
            X_WG = self._grasp.CalcPoseInWorld(self._kinematics)
            self._meshcat.SetTransform(self._bead(n), RigidTransform(X_WG.translation()), seconds)
        level = round(float(self._alpha.Eval(context)[0]) * (LEVELS - 1))
        for other in range(LEVELS):
            self._meshcat.SetProperty(self._collar(other), "visible", other == level, seconds)
