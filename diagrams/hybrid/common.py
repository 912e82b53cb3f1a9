"""What the analyses share: their common arguments, and how a report is written."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from diagrams.world.configuration import World
from diagrams.world.names import ENCODER, WEIGHTS
from diagrams.world.scenario import load_world
from models.checks import LARGEST_SEED, Range, require_numbers
from models.command_line import require_writable
from models.errors import InputError
from models.files.container import write_text

if TYPE_CHECKING:
    from diagrams.episodes.episode import Episode
    from diagrams.episodes.rollout import Rollout
    from models.inference import Encoder, Policy


@dataclass
class Arguments:
    """What every analysis takes; each is a subclass with its `run`."""

    out: Path = Path("outputs/analysis")  # folder of the report and its pictures
    seed: int = 0  # of whatever is random
    world: Path | None = None  # YAML file of the world, over the default one

    NAME: ClassVar[str]  # of the analysis, and of its report
    RANGES: ClassVar[dict[str, Range]] = {}  # least and most of each number

    def run(self) -> int:
        """Makes the analysis; returns 0 if what it checks holds, else 1."""
        raise NotImplementedError

    def check(self) -> None:
        """Raises InputError for a number out of its range, and where `out` cannot be made."""
        require_numbers(self, {"seed": (0, LARGEST_SEED), **self.RANGES})
        try:
            self.out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{self.out} cannot be written ({error.strerror}): choose another --out") from error
        require_writable(self._report)

    def loaded_world(self) -> World:
        """The world that is asked for; raises InputError as `load_world` does."""
        return load_world(self.world)

    def write(self, report: dict[str, Any]) -> None:
        """Writes the report (plain types) to NAME.json in `out`."""
        text = json.dumps({"seed": self.seed} | report)
        finite = json.loads(text, parse_constant=lambda _: None)  # JSON has no word for NaN and infinity
        write_text(self._report, json.dumps(finite, indent=1) + "\n")

    @property
    def _report(self) -> Path:
        return self.out / f"{self.NAME}.json"


@dataclass
class NetworkArguments(Arguments):
    """What the analyses with the trained networks take beside it."""

    rnn: str = "lstm"  # lstm, gru, mtrnn, or package.module:Class
    weights: Path = WEIGHTS  # folder of the trained networks

    def check(self) -> None:
        """Raises InputError also for a network that is not there."""
        super().check()
        self.policy_path  # noqa: B018 (there is one)

    @property
    def encoder_path(self) -> Path:
        """File of the encoder."""
        return self.weights / ENCODER

    @property
    def policy_path(self) -> Path:
        """File of the policy."""
        from diagrams.episodes.calibration import policy_file

        return policy_file(self.weights, self.rnn)

    def calibrated(self) -> tuple["Encoder", "Policy", float]:
        """The networks, and gamma; raises InputError where the policy has no calibration, WeightsError as both do."""
        from models.inference import Encoder, Policy

        encoder, policy = Encoder(self.encoder_path), Policy(self.policy_path)
        if policy.gamma is None:
            raise InputError(f"{self.policy_path} has no calibration: run diagrams/calibrate.py on it")
        return encoder, policy, float(policy.gamma)

    def closed_loop(self, kind: str = "none") -> tuple["Rollout", "Episode"]:
        """The closed loop, and the episode of `seed` under a disturbance of `kind`; raises InputError as both do."""
        from diagrams.episodes.calibration import require_named
        from diagrams.episodes.rollout import Rollout
        from diagrams.episodes.sampling import EpisodeSampler
        from models.inference import Encoder, Policy

        rollout = Rollout(self.loaded_world(), Encoder(self.encoder_path), Policy(self.policy_path), monitored=True)
        require_named(rollout.policy, self.rnn, self.policy_path)
        return rollout, EpisodeSampler(rollout.world).sample(self.seed, kind, rnn=rollout.policy.name)
