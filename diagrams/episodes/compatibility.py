"""Is the world that is run the one that the network was trained in?"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS
from models.errors import InputError

# What is taken for granted of a graph from elsewhere whose header has no entry `world`.
TRAINED_IN = {"models": World().models, "period": 0.1, "camera": [112, 112, 43.0], "closed_opening": 0.03}


def facts(world: World) -> dict[str, Any]:
    """What a network takes for granted: models, period (s), camera (pixels, pixels, deg), closed fingers (m)."""
    camera = world.camera
    return {
        "models": world.models,
        "period": world.timing.period,
        "camera": [camera.width, camera.height, camera.field_of_view_deg],
        "closed_opening": world.closed_opening,
    }


def of_data_sets(world: World) -> dict[str, Any]:
    """What a data set of runs in `world` says of all of them: see models/data/recording.py and lerobot.py."""
    return {
        "initial_posture": world.initial_posture,
        "period": world.timing.period,
        "world": json.dumps(facts(world)),
        "posture_names": json.dumps([f"joint_{j + 1}" for j in range(ARM_JOINTS)] + ["opening"]),
    }


def require_trained_for(world: World, policy) -> None:
    """Raises InputError where `policy` (see models/inference.py) was trained in another world; names both values.

    Of a policy of one's own (models/policy.py) nothing is taken for granted but its initial posture.
    """
    own = getattr(policy, "calibrated_beside", False)
    said = _plain(getattr(policy, "metadata", {}).get("world", {}))
    if own and (unknown := sorted(set(said) - set(TRAINED_IN))):
        raise InputError(
            f"the policy '{policy.name}' says of its world {', '.join(unknown)}: choose from {', '.join(TRAINED_IN)}"
        )
    trained: dict[str, Any] = ({} if own else TRAINED_IN) | said
    trained |= {"initial posture": np.asarray(policy.initial_posture), "components": len(policy.initial_posture)}
    initial = world.initial_posture
    have = facts(world) | {"initial posture": initial, "components": len(initial)}
    for name in ("models", "components", "initial posture", "period", "camera", "closed_opening"):
        if name not in trained:
            continue
        same = np.shape(have[name]) == np.shape(trained[name])
        if name == "models":
            same = have[name] == trained[name]
        elif same:
            same = np.allclose(have[name], trained[name], rtol=0.0, atol=1e-9)
        if not same:
            words = [np.array2string(np.asarray(value), precision=6) for value in (have[name], trained[name])]
            whose = f"the policy '{policy.name}' says" if own else "the network was trained with"
            remedy = "give it what is the world's" if own else "train a network in it"
            raise InputError(
                f"the world's {name.replace('_', ' ')} is {words[0]}, {whose} {words[1]}: change the world, or {remedy}"
            )


def _plain(world: Any) -> dict[str, Any]:
    """`world`, a weight file's; raises InputError unless its entries are numbers, and a name the models."""
    try:
        models = {name: str(value) for name, value in world.items() if name == "models"}
        return {name: np.array(value, float).tolist() for name, value in world.items() if name not in models} | models
    except (AttributeError, OverflowError, TypeError, ValueError) as error:
        raise InputError(f"the policy's metadata hold a world that is none, {world!r}: see facts() here") from error
