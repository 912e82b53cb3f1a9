"""A force on one body, as Drake's MultibodyPlant takes it."""

import numpy as np
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.multibody.tree import BodyIndex


def force_at(body: BodyIndex, point: np.ndarray, force: np.ndarray) -> ExternallyAppliedSpatialForce:
    """`force` (3,), N, world, without torque, at `point` (3,), m, in the body's frame."""
    made = ExternallyAppliedSpatialForce()
    made.body_index = body
    made.p_BoBq_B = point
    made.F_Bq_W = SpatialForce(tau=np.zeros(3), f=force)
    return made
