"""A force that pulls at a point of one body."""

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, LeafSystem

from systems.arguments import require_vector


def force_at(body: BodyIndex, point: np.ndarray, force: np.ndarray) -> ExternallyAppliedSpatialForce:
    """`force` (3,), N, world, without torque, at `point` (3,), m, in the body's frame: as Drake's plant takes it."""
    made = ExternallyAppliedSpatialForce()
    made.body_index = body
    made.p_BoBq_B = point
    made.F_Bq_W = SpatialForce(tau=np.zeros(3), f=force)
    return made


class BodyForce(LeafSystem):
    """Turns a force into what Drake's MultibodyPlant takes at its port `applied_spatial_force`.

    .. pydrake_system::

        name: BodyForce
        input_ports: [force]
        output_ports: [spatial_force]

    Inputs:
        force: (3,) N, in the world frame W.
    Outputs:
        spatial_force: list of one ExternallyAppliedSpatialForce, of that force and no torque, at the body's point.
            Direct feedthrough.
    """

    def __init__(self, body: BodyIndex, point):
        """
        Args:
            body: index of the body that is pulled, in its plant.
            point: (3,) where, m, in the body's frame.
        """
        super().__init__()
        self._body, self._point = body, require_vector("point", point, 3)
        self._force = self.DeclareVectorInputPort("force", 3)
        kind = Value[list[ExternallyAppliedSpatialForce]]
        self.DeclareAbstractOutputPort("spatial_force", kind, self._calc_force, {self._force.ticket()})

    def _calc_force(self, context: Context, output) -> None:
        output.set_value([force_at(self._body, self._point, self._force.Eval(context))])
