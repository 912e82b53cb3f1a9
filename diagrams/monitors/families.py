"""The two families of faults that tables tell apart: what the joints may tell, and what the picture alone can."""

from diagrams.world.faults.registry import FAULTS, is_fault
from diagrams.world.faults.scene_fault import SceneFault
from systems.faults.picture_fault import PictureFault

FAMILIES = ("arm and sensors", "camera and scene")


def family_of(kind: str) -> str:
    """One of FAMILIES, of a disturbance or fault by its name; A and B are the arm's."""
    seen = is_fault(kind) and issubclass(FAULTS[kind], PictureFault | SceneFault)
    return FAMILIES[1 if seen else 0]
