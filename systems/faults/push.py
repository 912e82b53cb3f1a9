"""What the pushes share: a person's force on a body of the arm, whose servo is soft meanwhile."""

from typing import ClassVar

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.framework import Context

from systems.body_force import force_at
from systems.faults.fault import Setting
from systems.faults.servo_fault import ServoFault

SOFTER = 0.95  # share of the joints' stiffness that is gone at severity 1


class Push(ServoFault):
    """A level force on the body `pushed`, of s times `newtons`; the joints have 1 - 0.95 s of their stiffness left.

    s is the severity; the direction in the world's x-y plane the seed says. See ServoFault for the ports, and
        spatial_force: list of one ExternallyAppliedSpatialForce while it acts, else an empty one.
    """

    acts_on = "force on the arm, servo"
    lasts = False
    takes_arm = True
    needs = ("joint_angles", "applied_spatial_force")
    pushed: ClassVar[str]  # of the setting's bodies
    newtons: ClassVar[float]

    def __init__(self, setting: Setting):
        super().__init__(setting)
        kind = Value[list[ExternallyAppliedSpatialForce]]
        self.DeclareAbstractOutputPort(
            "spatial_force", kind, self._calc_force, {self._onset.ticket(), self.pn_ticket()}
        )

    def _stiffness(self, context: Context, severity: float) -> np.ndarray:
        left = np.ones(self._setting.posture_size)
        left[: self._setting.joints] -= SOFTER * severity
        return left

    def _calc_force(self, context: Context, output) -> None:
        severity = self._strength(context)
        angle = self._chance(context).uniform(0.0, 2.0 * np.pi)
        force = severity * self.newtons * np.array([np.cos(angle), np.sin(angle), 0.0])
        output.set_value([force_at(*self._setting.bodies[self.pushed], force)] if severity else [])
