"""What Gymnasium calls when it is imported (entry point in pyproject.toml): names the environment, loads nothing."""

import gymnasium

ID = "PickPlace-v0"  # in the namespace Hindsight, the entry point's name


def register() -> None:
    """Registers the environment in the namespace that Gymnasium has chosen."""
    gymnasium.register(ID, entry_point="diagrams.episodes.gym_env:PickPlaceEnv")
