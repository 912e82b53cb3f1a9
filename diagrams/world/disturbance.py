"""The one type for a disturbance: in a scenario file, as sampled, in an episode, and as it is searched for."""

from dataclasses import dataclass

import numpy as np

from diagrams.world.names import ARM_JOINTS, MOVED
from models.checks import require_number
from models.errors import InputError
from systems.disturbance import KINDS, DisturbanceParameters

# The can leaves the hand with the fifth tick after the onset: by then the arm stands still.
CAN_TAKEN_TICKS = 5
MOST_HELD = 10_000  # ticks that the arm may be held


@dataclass
class DisturbanceSpec(DisturbanceParameters):
    """What the experimenter does, once: with a `level` all of it is given, without one it is sampled from the seed.

    `level` is in m: the distance of the hand to the can (subtask 1) or of the held can to its spot (subtask 2).
    `target` is seven joint angles, rad.
    """

    subtask: int = 1
    # X Y where the can is put, m, world. B in subtask 2: taken from the hand meanwhile; moved: at once, from the desk.
    can_moved_to: list[float] | None = None

    @property
    def takes_arm(self) -> bool:
        """Whether the arm is disturbed, and not at most the can."""
        return self.kind not in ("none", MOVED)

    @property
    def can_tick(self) -> int:
        """The tick since the onset in which the can is put elsewhere, if it is."""
        return 0 if self.kind == MOVED else CAN_TAKEN_TICKS - 1

    def check(self) -> None:
        """Raises InputError for what makes no disturbance; of a disturbance `none`, nothing else is read."""
        if self.kind not in KINDS:
            raise InputError(f"there is no disturbance '{self.kind}': choose one of {', '.join(KINDS)}")
        if self.kind == "none":
            return
        if self.level is None:
            if self != type(self)(kind=self.kind):
                raise InputError("disturbance.level is missing, without which all of it is sampled: give it in metres")
            return
        if not 0 < self.level < float("inf"):
            raise InputError(f"disturbance.level {self.level} is no distance: give a number greater than 0, in metres")
        if self.subtask not in (1, 2):
            raise InputError(f"there is no subtask {self.subtask} (disturbance.subtask): choose 1 or 2")
        if self.hold_ticks < (1 if self.kind == "B" else 0):
            raise InputError(f"disturbance.hold_ticks {self.hold_ticks} is too short: choose 1 or more (A: 0 or more)")
        require_number("disturbance.hold_ticks", self.hold_ticks, 0, MOST_HELD)
        wanted = ARM_JOINTS if self.kind == "A" else 0
        if len(self.target or []) != wanted or not np.all(np.isfinite(self.target or [])):
            words = f"does not fit disturbance {self.kind}: give {wanted} joint angles in rad"
            raise InputError(f"disturbance.target {self.target} {words}")
        if (moved := self.can_moved_to) is None:
            if self.kind == MOVED:
                raise InputError(
                    "disturbance.can_moved_to is missing: give the x and y where the can is put, in metres"
                )
            return
        if len(moved) != 2 or not np.all(np.isfinite(moved)):
            raise InputError(f"disturbance.can_moved_to {moved} is not two numbers: give x and y in metres")
        taken = self.kind == "B" and self.subtask == 2 and self.hold_ticks >= CAN_TAKEN_TICKS
        if not taken and (self.kind != MOVED or self.subtask != 1):
            raise InputError(
                f"disturbance.can_moved_to {moved} moves nothing under {self.kind} in subtask {self.subtask} with "
                f"hold_ticks {self.hold_ticks}: the can is taken from the hand under B in subtask 2, held for "
                f"{CAN_TAKEN_TICKS} ticks or more, and moved on the desk under {MOVED} in subtask 1; change these, or "
                "leave it out"
            )
