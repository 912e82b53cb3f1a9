"""The face of a policy of your own: posture and picture in, posture out; state, prediction and recall where it has any.

`--policy package.module:Class` of pick_place.py, sweep.py and calibrate.py flies one; diagrams/INTERFACES.md says how.
The trained networks (models/inference.py) have the same face from `step` on.
"""

import hashlib
import inspect
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from models.data.scaling import MinMaxScaling
from models.errors import InputError
from models.registry import Registry

POLICIES: Registry = Registry("policy", {})  # ours are files, found by --rnn
FEATURES = 30  # of the encoder that ships


@dataclass(frozen=True)
class Seen:
    """What a policy is given at a tick.

    Attributes:
        posture: (M,) rad and m, measured; off the learned trajectory what the policy predicted takes its place (Eq. 7).
        features: (F,) in [-1, 1], of the picture; likewise (Eq. 8).
        picture: (112, 112, 3) uint8, what the camera sees, with `looks`; else None.
    """

    posture: np.ndarray
    features: np.ndarray
    picture: np.ndarray | None = None


@dataclass(frozen=True)
class Decision:
    """What it answers.

    Attributes:
        posture: (M,) rad and m, of the next tick: the command where alpha is 0, the prediction that Eqs. 6, 7 take.
        state: (S,) its hidden state, which it is given at the next tick; nothing else may be remembered.
        features: (F,) predicted for the next tick; None: they stay as they are.
        recalled: (N, M) rad and m, row n - 1 is the posture n ticks ago, out of the state alone; with `recalls`.
    """

    posture: np.ndarray
    state: np.ndarray | Sequence[float] = ()
    features: np.ndarray | None = None
    recalled: np.ndarray | None = None


class Policy(ABC):
    """A subclass gives `name`, `initial_posture` and `act`, takes no argument, and keeps nothing between two calls.

    Attributes:
        name: short; the files that go with it have it.
        initial_posture: (M,) rad and m, where it begins; the world's, or it is refused.
        initial_state: (S,) c_0, also after each return home; S is 0 where there is no state.
        recalls, horizon: whether it recalls, and how many ticks N (also of the history that detectors see).
        looks: it wants the picture itself; then its features are one zero, unless it has `encode`.
        feature_size: F. A method `encode(picture) -> (F,)`, if it has one, takes the place of the encoder that ships.
        lower, upper: (M,) bounds of the posture, rad and m: what is predicted beyond is clipped.
        files: what it reads, weights: they and its source decide `hash`, by which calibrations are found.
    """

    name: str
    initial_posture: np.ndarray
    initial_state: np.ndarray = np.zeros(0)
    recalls: bool = False
    horizon: int = 10
    looks: bool = False
    lower: float | np.ndarray = -np.pi
    upper: float | np.ndarray = np.pi
    files: Sequence[Path] = ()
    encoder_hash: str | None = None  # of the encoder that it was trained with, if that matters
    metadata: dict[str, Any] = {}  # noqa: RUF012 (never written)
    calibrated_beside: bool = True  # it has no file: its calibrations lie in those of the detectors

    @abstractmethod
    def act(self, seen: Seen, state: np.ndarray) -> Decision:
        """One tick."""

    @property
    def feature_size(self) -> int:
        """F."""
        return 1 if self.looks else FEATURES

    @property
    def posture_size(self) -> int:
        """M."""
        return len(self.initial_posture)

    @property
    def state_size(self) -> int:
        """S."""
        return len(self.initial_state)

    @cached_property
    def scaling(self) -> MinMaxScaling:
        """By `lower` and `upper`."""
        size = np.ones(self.posture_size)
        return MinMaxScaling(self.lower * size, self.upper * size)

    @cached_property
    def hash(self) -> str:
        """SHA-256 of its name, its module's source and its files."""
        name = type(self).__qualname__.encode()
        paths = [Path(inspect.getfile(type(self))), *map(Path, self.files)]
        return hashlib.sha256(name + b"".join(hashlib.sha256(path.read_bytes()).digest() for path in paths)).hexdigest()

    def step(
        self, x: np.ndarray, state: np.ndarray, picture: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """What the controller asks for, scaled: see models/inference.py; without `recalls` nothing is recalled."""
        size = self.posture_size
        done = self.act(Seen(self.scaling.unscale(x[:size]), np.array(x[size:]), picture), np.array(state))
        features = x[size:] if done.features is None else np.asarray(done.features, float)
        recalled = done.recalled
        found = np.shape(done.posture), features.shape, np.shape(done.state), recalled is not None
        if found != ((size,), (self.feature_size,), (self.state_size,), self.recalls):
            raise ValueError(
                f"{self.name}.act decided on {np.shape(done.posture)} postures, {features.shape} features, a state "
                f"{np.shape(done.state)}, {'a' if recalled is not None else 'no'} recall; it says ({size},), "
                f"({self.feature_size},), ({self.state_size},), recalls {self.recalls}: let both agree."
            )
        y = np.concatenate((self.scaling.scale(np.asarray(done.posture, float)), features))
        if recalled is not None:
            recalled = self.scaling.scale(np.asarray(recalled, float))
        return y, np.asarray(done.state, float), recalled


class NoFeatures:
    """In the place of an encoder where the policy looks at the picture itself: one zero."""

    feature_size = 1

    def encode(self, rgb: np.ndarray) -> np.ndarray:
        """(1,)."""
        return np.zeros(1)


def make_policy(spec: str) -> Policy:
    """The policy that `spec` names (package.module:Class); raises InputError where there is none, or what is none."""
    kind = POLICIES[spec]
    if not (isinstance(kind, type) and issubclass(kind, Policy)):
        raise InputError(f"the policy '{spec}' is no Policy: make it a subclass (models/policy.py)")
    policy = kind()
    initial = np.asarray(getattr(policy, "initial_posture", ()), float)
    if initial.ndim != 1 or not initial.size or not np.isfinite(initial).all():
        raise InputError(f"the policy '{spec}' has no initial_posture: give it the world's, (M,), rad and m")
    return policy
