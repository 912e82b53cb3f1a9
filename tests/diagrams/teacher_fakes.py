"""Demonstrations without physics; importable by a worker without Drake."""

import numpy as np

from models.data.recording import Recording


def recording(index=0, ticks=40, **changes):
    """Made up from the index."""
    rng = np.random.default_rng(index)
    given = {
        "name": f"demo_{index}",
        "rgb": rng.integers(0, 255, (ticks, 112, 112, 3), np.uint8),
        "posture": rng.normal(size=(ticks, 8)),
        "actions": rng.normal(size=(ticks, 8)),
        "can_xy": np.array([0.44, 0.01 * index]),
        "vacant": "left",
        "grid_index": (0, index),
        "subtask_starts": (0, 15),
        "split": "train" if index % 2 == 0 else "valid",
        "success": True,
    }
    return Recording(**(given | changes))


def demonstrate(job):
    """In the place of diagrams.teach.demonstrate."""
    _, setup = job
    return recording(int(setup.name[5:]), can_xy=np.array([setup.turn, 0.0]))
