"""Something heavy hangs at the hand, which the compensation of gravity does not know."""

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.framework import Context

from systems.body_force import force_at
from systems.faults.fault import Fault, Setting

LARGEST = 2.0  # kg, at severity 1
GRAVITY = 9.81  # m/s^2


class Payload(Fault):
    """The weight of 2 s kg pulls at the hand, s the severity.

    .. pydrake_system::

        name: Payload
        input_ports: [ticks_since_onset]
        output_ports: [acting, spatial_force]

    Outputs:
        spatial_force: list of one ExternallyAppliedSpatialForce at the hand while it acts, else an empty one.

    It stands for the weight alone: a force has no inertia.
    """

    name = "payload"
    severity_1 = "the weight of 2 kg at the hand"
    acts_on = "force on the hand"
    needs = ("applied_spatial_force",)

    def __init__(self, setting: Setting):
        super().__init__(setting)
        kind = Value[list[ExternallyAppliedSpatialForce]]
        self.DeclareAbstractOutputPort(
            "spatial_force", kind, self._calc_force, {self._onset.ticket(), self.pn_ticket()}
        )

    def _calc_force(self, context: Context, output) -> None:
        severity = self._strength(context)
        weight = np.array([0.0, 0.0, -severity * LARGEST * GRAVITY])
        output.set_value([force_at(*self._setting.bodies["hand"], weight)] if severity else [])
