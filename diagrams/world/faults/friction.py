"""Can and fingers are slippery."""

import numpy as np
from pydrake.geometry import ProximityProperties, Role, RoleAssign
from pydrake.multibody.plant import CoulombFriction
from pydrake.systems.framework import Context

from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.faults.scene_fault import SceneFault
from diagrams.world.names import CANS, FINGERS
from diagrams.world.station import PickPlaceStation

LARGEST = 0.9  # share of the friction that is gone at severity 1
MATERIAL = "material", "coulomb_friction"  # Drake's names of group and property


class Friction(SceneFault):
    """The can to pick and the fingers have 1 - 0.9 s of their coefficients of friction, s the severity.

    .. pydrake_system::

        name: Friction
        input_ports: [ticks_since_onset]
        output_ports: [acting]

    The coefficients are parameters of the scene graph's Context, which no event may change: they are so from the start.
    """

    name = "friction"
    severity_1 = "a tenth of the friction of can and fingers"
    acts_on = "contact"
    from_start = True

    def set_scene(self, root: Context, station: PickPlaceStation, given: DisturbanceSpec, stands: np.ndarray) -> None:
        """See SceneFault."""
        left = 1.0 - LARGEST * self.severity(self.GetMyContextFromRoot(root))
        if left == 1.0:
            return
        plant, graph = station.plant, station.scene_graph
        context = graph.GetMyMutableContextFromRoot(root)
        # Of the Context, not of the model: Drake adds its defaults there.
        inspector = graph.get_query_output_port().Eval(context).inspector()
        owners = {CANS[0], "gripper"}, {"can", *(f"{side}_finger" for side in FINGERS)}
        for shape in inspector.GetAllGeometryIds(Role.kProximity):
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
            names = plant.GetModelInstanceName(body.model_instance()), body.name()
            if all(name in allowed for name, allowed in zip(names, owners, strict=True)):
                properties = ProximityProperties(inspector.GetProximityProperties(shape))
                was = properties.GetPropertyOrDefault(*MATERIAL, CoulombFriction(1.0, 1.0))
                slippery = CoulombFriction(left * was.static_friction(), left * was.dynamic_friction())
                properties.UpdateProperty(*MATERIAL, slippery)
                graph.AssignRole(context, plant.get_source_id(), shape, properties, RoleAssign.kReplace)
