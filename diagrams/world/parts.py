"""What the models of a world must hold: other files look it up by these names."""

from pydrake.multibody.plant import MultibodyPlant

from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, CANS, FINGERS, SPOTS
from models.errors import InputError

CAMERAS = ("camera", "film_camera")  # frames: the network's, and one for people
# By model and kind.
PARTS: dict[str, dict[str, tuple[str, ...]]] = {
    "desk": {},
    "arm": {
        "body": ("base", *(f"link_{j + 1}" for j in range(ARM_JOINTS))),
        "joint": (joints := tuple(f"joint_{j + 1}" for j in range(ARM_JOINTS))),
        "actuator": joints,
    },
    "gripper": {
        "body": ("palm", *(f"{side}_finger" for side in FINGERS)),
        "frame": ("grasp",),
        "joint": tuple(f"{side}_finger_joint" for side in FINGERS),
        "actuator": ("left_finger_joint",),
    },
    "shelf": {"frame": tuple(f"{spot}_spot" for spot in SPOTS)},
    **{can: {"body": ("can",)} for can in CANS},
}


def require_parts(plant: MultibodyPlant, world: World, names: tuple[str, ...] | None) -> None:
    """Raises InputError for what a program looks up and the models of `world` have not; `names` as in `add_models`."""
    for name, kinds in PARTS.items():
        if names and name not in names:
            continue
        if not plant.HasModelInstanceNamed(name):
            raise InputError(f"sdf/{world.models} has no model '{name}': name one so")
        model = plant.GetModelInstanceByName(name)
        has = {
            "body": plant.HasBodyNamed,
            "frame": plant.HasFrameNamed,
            "joint": plant.HasJointNamed,
            "actuator": plant.HasJointActuatorNamed,
        }
        for kind, part in ((kind, part) for kind, parts in kinds.items() for part in parts):
            if not has[kind](part, model):
                raise InputError(f"sdf/{world.models}: the model '{name}' has no {kind} '{part}': name one so")
    for frame in () if names else CAMERAS:
        if not plant.HasFrameNamed(frame):
            raise InputError(f"sdf/{world.models} has no frame '{frame}': add one for the camera, z into the picture")
