"""The one list of the faults; and the names of everything that can disturb a run."""

from models.errors import InputError
from models.registry import Registry
from systems.disturbance import KINDS

_ARM = (
    "camera_gain", "camera_colour", "camera_shadow", "camera_blur", "camera_noise", "camera_occlusion",
    "camera_frozen", "camera_dropped", "camera_shift", "camera_latency", "joint_offset", "joint_noise", "joint_stuck",
    "late_step", "payload", "weak_servo", "slack_gripper", "push_hand", "push_elbow", "disturbed_return",
    "disturbed_resumption", "disturbed_thrice",
)  # fmt: skip
_SCENE = ("friction", "can_moved", "can_moved_far", "can_toppled", "neighbour_moved")


def _entries(room: str, names: tuple[str, ...]) -> dict[str, str]:
    """A fault's file has its name, its class the same in capitals."""
    return {name: f"{room}.{name}:{name.title().replace('_', '')}" for name in names}


FAULTS: Registry = Registry("fault", _entries("systems.faults", _ARM) | _entries("diagrams.world.faults", _SCENE))


def is_fault(kind: str) -> bool:
    """Whether `kind` is not one of Disturbance's own kinds."""
    return kind not in KINDS


def require_kind(kind: str) -> None:
    """Raises InputError unless `kind` is one of Disturbance's own, or names a fault."""
    if is_fault(kind) and kind not in (names := tuple(FAULTS)) and ":" not in kind:
        choices = ", ".join((*KINDS, *names))
        raise InputError(f"there is no disturbance '{kind}': choose from {choices}, or give package.module:Class")
    if is_fault(kind):
        FAULTS.check(kind)


def kind_label(kind: str) -> str:
    """The short name of a kind: for rows, tables and file names."""
    return FAULTS.label(kind) if is_fault(kind) else kind


def require_severity(kind: str, severity: float) -> None:
    """Raises InputError for a severity that is none, or that says nothing to `kind`."""
    if not 0.0 <= severity <= 1.0:
        raise InputError(f"the severity {severity} is out of range: choose from 0 to 1")
    if severity != 1.0 and not is_fault(kind):
        raise InputError(f"the severity {severity} says nothing to the disturbance '{kind}': leave it out")
