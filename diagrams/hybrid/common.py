"""What the analyses share: their common arguments, and how a report is written."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from diagrams.world.configuration import World
from diagrams.world.names import ENCODER, WEIGHTS
from diagrams.world.scenario import load_world
from models.errors import InputError
from models.networks import NETWORKS

if TYPE_CHECKING:
    from diagrams.episodes.rollout import Rollout


@dataclass
class Arguments:
    """What every analysis takes."""

    out: Path = Path("outputs/analysis")  # folder of the report and its pictures
    seed: int = 0  # of whatever is random
    scenario: Path | None = None  # YAML file, whose world is taken

    LEAST: ClassVar[dict[str, int]] = {"seed": 0}  # smallest value of each number

    def check(self) -> None:
        """Raises InputError for a number that is too small, and where `out` cannot be made."""
        for kind in type(self).__mro__:
            for name, least in vars(kind).get("LEAST", {}).items():
                value = getattr(self, name)
                if value is not None and value < least:
                    raise InputError(f"--{name.replace('_', '-')} {value} is too small: choose {least} or more")
        try:
            self.out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{self.out} cannot be written ({error.strerror}): choose another --out") from error

    def world(self) -> World:
        """The world of the scenario; raises InputError as `load_world` does."""
        return load_world(self.scenario)

    def write(self, name: str, report: dict[str, Any]) -> None:
        """Writes the report (plain types) to NAME.json in `out`."""
        text = json.dumps(_finite({"seed": self.seed} | report), indent=1, allow_nan=False)
        (self.out / f"{name}.json").write_text(text + "\n")


@dataclass
class NetworkArguments(Arguments):
    """What the analyses with the trained networks take beside it."""

    rnn: str = "lstm"  # lstm, gru, mtrnn, or package.module:Class
    weights: Path = WEIGHTS  # folder of the trained networks

    def check(self) -> None:
        """Raises InputError also for a network that is not there."""
        super().check()
        NETWORKS.check(self.rnn)

    @property
    def encoder_path(self) -> Path:
        """File of the autoencoder."""
        return self.weights / ENCODER

    @property
    def policy_path(self) -> Path:
        """File of the policy."""
        from diagrams.episodes.calibration import policy_name

        return self.weights / policy_name(self.rnn)

    def rollout(self, world: World) -> Rollout:
        """The closed loop; raises InputError as Encoder, Policy and Rollout do."""
        from diagrams.episodes.rollout import Rollout
        from models.inference import Encoder, Policy

        return Rollout(world, Encoder(self.encoder_path), Policy(self.policy_path))


def _finite(value: Any) -> Any:
    """`value` with None for every number that is not finite, for which JSON has no word."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
