"""One episode and its world, as a scenario file holds them (YAML over the defaults)."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from diagrams.world.configuration import World
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.hands_schedule import HandsSchedule
from diagrams.world.names import SPOTS
from diagrams.world.plain_yaml import plain_yaml
from models.checks import LARGEST_SEED, require_number
from models.errors import InputError
from models.files.container import write_text
from models.networks import network_label
from models.policy import POLICIES, make_policy
from systems.detectors import DETECTORS
from systems.recoveries.registry import RECOVERIES, SHIPPED

MOST_WORDS = 500  # letters of a reason that are told


@dataclass
class Scenario:
    """One episode and its world: what a scenario file can hold."""

    rnn: str = "lstm"  # lstm, gru, mtrnn, another file's name, or package.module:Class
    detector: str = "recall"  # recall, knn, subspace, never, or package.module:Class
    seed: int = 0  # of the can's position, the vacant spot, and the disturbance's moment and posture
    can: list[float] | None = None  # X Y of the can to pick, m, world; sampled where not given
    vacant: str | None = None  # left or right; sampled where not given
    disturbance: DisturbanceSpec = field(default_factory=lambda: DisturbanceSpec(kind="A"))
    world: World = field(default_factory=World)
    policy: str | None = None  # package.module:Class of one's own (models/policy.py), instead of rnn
    hands: HandsSchedule = field(default_factory=HandsSchedule)  # what a person did, as live.py --save leaves it
    recovery: str = SHIPPED  # after an alarm: planned, backoff, regulator, hold, retrace, or package.module:Class

    @property
    def label(self) -> str:
        """The short name of the network, or of the policy."""
        return network_label(self.rnn) if self.policy is None else POLICIES.label(self.policy)

    def check(self) -> None:
        """Raises InputError for a value outside its choices."""
        network_label(self.rnn)
        if self.policy is not None:
            if self.rnn != Scenario.rnn:
                raise InputError(f"the policy '{self.policy}' and the network '{self.rnn}' are given: leave one out")
            make_policy(self.policy)
        DETECTORS.check(self.detector)
        RECOVERIES.check(self.recovery)
        if self.vacant not in (*SPOTS, None):
            raise InputError(f"there is no vacant spot '{self.vacant}': choose one of {', '.join(SPOTS)}")
        if self.seed < 0:
            raise InputError(f"the seed {self.seed} is negative: choose a whole number from 0 on")
        require_number("the seed", self.seed, 0, LARGEST_SEED)
        if self.can is not None and (len(self.can) != 2 or not all(map(math.isfinite, self.can))):
            raise InputError(f"the can's position {self.can} does not have two numbers: give x and y in metres")
        self.disturbance.check()
        self.hands.check()
        self.world.check()


@contextmanager
def naming_file(path: Path | None, what: str = "scenario") -> Iterator[None]:
    """An InputError of the block says too which file `path`, a `what`, was read: its value may stand there."""
    try:
        yield
    except InputError as error:
        if path is not None:
            error.add_note(f"the {what} file is {path}")
        raise


Loaded = TypeVar("Loaded", Scenario, World)


def load_scenario(path: Path, world: World | None = None) -> Scenario:
    """The scenario in the YAML file `path`, over `world` and the defaults; raises InputError for what does not fit."""
    return _load(path, "scenario", Scenario(world=world or World()), "scenario.py")


def load_world(path: Path | None) -> World:
    """The world in the YAML file `path`, over the default one; raises InputError for what does not fit."""
    world = World() if path is None else _load(path, "world", World(), "configuration.py")
    with naming_file(path, "world"):
        world.check()
    return world


def _load(path: Path, what: str, defaults: Loaded, source: str) -> Loaded:
    """What the YAML file `path` holds, a `what`, over `defaults`, whose class stands in `source`."""
    from pydrake.common.yaml import yaml_load_typed

    if not path.is_file():
        raise InputError(f"there is no {what} file {path}: check the name")
    try:
        text = plain_yaml(path, type(defaults))
        return yaml_load_typed(schema=type(defaults), data=text, defaults=defaults)
    except Exception as error:  # the loader raises many types, each with its own words for what does not fit
        reason = " ".join(str(error).split())[:MOST_WORDS] or type(error).__name__
        keys = f"its keys are those of {type(defaults).__name__} in diagrams/world/{source}"
        raise InputError(f"the {what} file {path} does not fit: {reason}; change that, {keys}") from error


def save_scenario(path: Path, scenario: Scenario, comments: list[str] | None = None) -> None:
    """Writes what differs from the defaults to `path` (YAML), below `comments`; load_scenario reads the same bits."""
    from pydrake.common.yaml import yaml_dump_typed

    text = yaml_dump_typed(scenario, defaults=Scenario())
    write_text(path, "".join(f"# {line}\n" for line in comments or []) + text)
