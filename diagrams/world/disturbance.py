"""The one type for a disturbance: in a scenario file, as sampled, in an episode, and as it is searched for."""

from dataclasses import dataclass

import numpy as np

from diagrams.world.faults.registry import FAULTS, is_fault, kind_label, require_kind, require_severity
from diagrams.world.names import ARM_JOINTS, MOVED
from models.checks import require_number
from models.errors import InputError
from systems.disturbance import DisturbanceParameters

# The can leaves the hand with the fifth tick after the onset: by then the arm stands still.
CAN_TAKEN_TICKS = 5
MOST_HELD = 10_000  # ticks that the arm may be held


@dataclass
class DisturbanceSpec(DisturbanceParameters):
    """What the experimenter does, once: with a `level` all of it is given, without one it is sampled from the seed.

    `level` is in m: the distance of the hand to the can (subtask 1) or of the held can to its spot (subtask 2).
    `target` is seven joint angles, rad; of a fault that moves the arm more than once, seven for each time.
    `kind` may also name a fault (diagrams/world/faults/registry.py), or give one as package.module:Class.
    """

    subtask: int = 1
    # X Y where the can is put, m, world. B in subtask 2: taken from the hand meanwhile; moved: at once, from the desk;
    # a fault that moves a can: of severity 1.
    can_moved_to: list[float] | None = None

    @property
    def takes_arm(self) -> bool:
        """Whether somebody disturbs the arm, and not at most the can, a sensor or a part of it."""
        if self.fault is not None:
            return bool(self.fault.takes_arm and self.severity)
        return self.kind not in ("none", MOVED)

    @property
    def fault(self):
        """The class of the fault, a systems.faults.fault.Fault; None: it is one of Disturbance's own kinds."""
        return FAULTS[self.kind] if is_fault(self.kind) else None

    @property
    def several(self) -> bool:
        """Whether the arm is taken more than once."""
        return self.fault is not None and self.fault.targets > 1

    @property
    def label(self) -> str:
        """The short name of the kind."""
        return kind_label(self.kind)

    @property
    def onset(self) -> DisturbanceParameters:
        """What the system Disturbance is told: of a fault the onset alone."""
        return self if self.fault is None else DisturbanceParameters(MOVED, self.level)

    @property
    def can_tick(self) -> int:
        """The tick since the onset in which the can is put elsewhere, if it is."""
        return 0 if self.kind == MOVED else CAN_TAKEN_TICKS - 1

    def check(self) -> None:
        """Raises InputError for what makes no disturbance; of a disturbance `none`, nothing else is read."""
        require_kind(self.kind)
        require_severity(self.kind, self.severity)
        if self.kind == "none":
            return
        if self.level is None:
            if self != type(self)(kind=self.kind, severity=self.severity):
                raise InputError("disturbance.level is missing, without which all of it is sampled: give it in metres")
            return
        if not 0 < self.level < float("inf"):
            raise InputError(f"disturbance.level {self.level} is no distance: give a number greater than 0, in metres")
        if self.subtask not in (1, 2):
            raise InputError(f"there is no subtask {self.subtask} (disturbance.subtask): choose 1 or 2")
        if self.fault is not None:
            self._check_fault()
            return
        if self.hold_ticks < (1 if self.kind == "B" else 0):
            raise InputError(f"disturbance.hold_ticks {self.hold_ticks} is too short: choose 1 or more (A: 0 or more)")
        require_number("disturbance.hold_ticks", self.hold_ticks, 0, MOST_HELD)
        self._require_target(ARM_JOINTS if self.kind == "A" else 0)
        if (moved := self.can_moved_to) is None:
            if self.kind == MOVED:
                raise InputError(
                    "disturbance.can_moved_to is missing: give the x and y where the can is put, in metres"
                )
            return
        self._require_place(moved)
        taken = self.kind == "B" and self.subtask == 2 and self.hold_ticks >= CAN_TAKEN_TICKS
        if not taken and (self.kind != MOVED or self.subtask != 1):
            raise InputError(
                f"disturbance.can_moved_to {moved} moves nothing under {self.kind} in subtask {self.subtask} with "
                f"hold_ticks {self.hold_ticks}: the can is taken from the hand under B in subtask 2, held for "
                f"{CAN_TAKEN_TICKS} ticks or more, and moved on the desk under {MOVED} in subtask 1; change these, or "
                "leave it out"
            )

    def _check_fault(self) -> None:
        """The rest of `check` where all of a fault is given."""
        fault, least = self.fault, 0 if self.fault.lasts or self.fault.targets else 1
        if fault.subtask not in (None, self.subtask):
            raise InputError(
                f"disturbance.subtask {self.subtask} is not that of {self.label}: choose {fault.subtask}, in which "
                "it begins"
            )
        if self.hold_ticks < least or (fault.lasts and self.hold_ticks):
            words = "0: it lasts to the end" if fault.lasts else f"{least} or more"
            raise InputError(f"disturbance.hold_ticks {self.hold_ticks} does not fit {self.label}: choose {words}")
        require_number("disturbance.hold_ticks", self.hold_ticks, 0, MOST_HELD)
        self._require_target(ARM_JOINTS * fault.targets)
        wanted = getattr(fault, "moved_by", None) is not None
        if wanted != (self.can_moved_to is not None):
            words = "give the x and y where a can is put, in metres" if wanted else "leave it out: it moves none there"
            raise InputError(f"disturbance.can_moved_to {self.can_moved_to} does not fit {self.label}: {words}")
        if self.can_moved_to is not None:
            self._require_place(self.can_moved_to)

    def _require_target(self, wanted: int) -> None:
        if len(self.target or []) != wanted or not np.all(np.isfinite(self.target or [])):
            words = f"does not fit disturbance {self.label}: give {wanted} joint angles in rad"
            raise InputError(f"disturbance.target {self.target} {words}")

    def _require_place(self, place: list[float]) -> None:
        if len(place) != 2 or not np.all(np.isfinite(place)):
            raise InputError(f"disturbance.can_moved_to {place} is not two numbers: give x and y in metres")
