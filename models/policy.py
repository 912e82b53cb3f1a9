"""The face of a policy of your own: posture and picture in, posture out; state, prediction and recall where it has any.

`--policy package.module:Class` of pick_place.py, sweep.py and calibrate.py flies one; diagrams/INTERFACES.md says how.
The trained networks (models/inference.py) have the same face from `step` on.
"""

import hashlib
import inspect
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from models.command_line import EXTRAS
from models.data.scaling import MinMaxScaling
from models.errors import InputError
from models.registry import Registry

POLICIES: Registry = Registry("policy", {})  # ours are files, found by --rnn
FEATURES = 30  # of the encoder that ships
PICTURE = (112, 112, 3)
_NOT_ITS_OWN = {*sys.stdlib_module_names, "diagrams", "models", "systems"}  # modules that are not hashed with a policy


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
        files: what it reads: they, its source and that of its base classes decide `hash`, by which calibrations are
            found. Modules that it imports besides belong here, if what they say decides its answers.
        encoder_hash: of the encoder that it was trained with (`models.inference.Encoder(FILE).hash`); another is
            refused. One that answers by `features` without an eye of its own has to say it.
        metadata: `world`, if it is there, says what it takes for granted, any of models (the file's name in sdf/),
            period (s), camera ([pixels, pixels, deg]), closed_opening (m): another world is refused.
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
    encoder_hash: str | None = None
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
        """SHA-256 of its name, the source of its module and of those of its base classes, and its files."""
        name = type(self).__qualname__.encode()
        bases = [kind for kind in type(self).__mro__[1:] if kind.__module__.partition(".")[0] not in _NOT_ITS_OWN]
        sources = dict.fromkeys(Path(inspect.getfile(kind)) for kind in (type(self), *bases))
        paths = [*sources, *map(Path, self.files)]
        return hashlib.sha256(name + b"".join(hashlib.sha256(path.read_bytes()).digest() for path in paths)).hexdigest()

    def step(
        self, x: np.ndarray, state: np.ndarray, picture: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """What the controller asks for, scaled: see models/inference.py; without `recalls` nothing is recalled.

        Raises InputError where `act` raises, or answers with other sizes than it says, or with what is not finite.
        """
        size = self.posture_size
        seen = Seen(self.scaling.unscale(x[:size]), np.array(x[size:]), picture)
        try:
            done = self.act(seen, np.array(state))
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise InputError(f"{self.name}.act raised {reason}, at the posture {seen.posture}: change it") from error
        features = x[size:] if done.features is None else np.asarray(done.features, float)
        recalled = done.recalled
        wanted = (size,), (self.feature_size,), (self.state_size,), (self.horizon, size) if self.recalls else None
        given = done.posture, features, done.state, recalled
        found = tuple(None if part is None else np.shape(part) for part in given)
        if found != wanted:
            words = ("posture", "features", "state", "recalled")
            raise InputError(
                f"{self.name}.act decided on {_words(words, found)}; it says {_words(words, wanted)}: let both agree"
            )
        if not all(np.isfinite(np.asarray(part, float)).all() for part in given if part is not None):
            raise InputError(f"{self.name}.act decided on numbers that are not finite: check it, and what it was given")
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
    """The policy that `spec` names (package.module:Class), after one trial of `act`, at the initial posture.

    Raises InputError where there is none, what is none, and for one that does not do as it says.
    """
    kind = POLICIES[spec]
    if not (isinstance(kind, type) and issubclass(kind, Policy)):
        raise InputError(f"the policy '{spec}' is no Policy: make it a subclass (models/policy.py)")
    with _refusing(spec, "cannot be made", "it takes no argument, has `act`, and finds its files"):
        policy = kind()
    initial = _numbers(getattr(policy, "initial_posture", None))
    if not initial.size:
        raise InputError(f"the policy '{spec}' has no initial_posture: give it the world's, (M,), rad and m")
    lower, upper = (_numbers(bound, initial.shape) for bound in (policy.lower, policy.upper))
    if not (lower.size and upper.size and np.all(lower < upper) and np.all((lower <= initial) & (initial <= upper))):
        raise InputError(
            f"the policy '{spec}' has the bounds lower {policy.lower} and upper {policy.upper}: give ({initial.size},) "
            f"numbers, rad and m, around its initial_posture {initial.round(3)}"
        )
    if np.size(policy.initial_state) and not _numbers(policy.initial_state).size:
        raise InputError(f"the policy '{spec}' has no initial_state (S,): give finite numbers, or none")
    for name, number in (("horizon", policy.horizon), ("feature_size", policy.feature_size)):
        if not isinstance(number, int | np.integer) or number < 1:
            raise InputError(f"the policy '{spec}' has the {name} {number}: give a whole number from 1 on")
    if absent := [str(file) for file in policy.files if not Path(file).is_file()]:
        raise InputError(f"the policy '{spec}' has no file {', '.join(absent)}: give `files` that are there")
    with _refusing(spec, "does not act", "it takes and gives what models/policy.py says"):
        one, other = _tried(policy, initial)
        _ = policy.hash  # its source is found
    own_eye = policy.looks or hasattr(policy, "encode")
    if not own_eye and policy.encoder_hash is None and not np.array_equal(one, other):
        raise InputError(
            f"the policy '{spec}' answers by the features, of no encoder that it names: give it encoder_hash, the "
            "`models.inference.Encoder(FILE).hash` of the one that it was trained with"
        )
    return policy


def _tried(policy: Policy, initial: np.ndarray) -> list[np.ndarray]:
    """Posture and state after one tick, for two lots of features; or for those of a black picture."""
    picture = np.zeros(PICTURE, np.uint8)
    seen = [np.full(policy.feature_size, value) for value in (0.0, 0.5)]
    if encode := getattr(policy, "encode", None):
        seen = [np.asarray(encode(picture), float)] * 2
        if seen[0].shape != (policy.feature_size,):
            raise InputError(
                f"{policy.name}.encode gives {seen[0].shape}, feature_size is {policy.feature_size}: let both agree"
            )
    answers = []
    for features in seen:
        x = np.append(policy.scaling.scale(initial), features)
        y, state, _ = policy.step(x, np.asarray(policy.initial_state, float), picture if policy.looks else None)
        answers.append(np.append(y[: initial.size], state))
    return answers


def _numbers(value: Any, shape: tuple[int, ...] | None = None) -> np.ndarray:
    """`value` as (n,) finite numbers, or a number for all of `shape`; (0,) where it is none."""
    try:
        found = np.asarray(value, float)
        if shape is not None and found.ndim == 0:
            found = np.full(shape, found)
    except (TypeError, ValueError):
        return np.empty(0)
    fits = found.ndim == 1 and shape in (None, found.shape) and np.isfinite(found).all()
    return found if fits else np.empty(0)


@contextmanager
def _refusing(spec: str, what: str, remedy: str) -> Iterator[None]:
    """Makes an InputError of what a stranger's code raises; of a missing extra not: the program names it."""
    try:
        yield
    except Exception as error:
        absent = isinstance(error, ModuleNotFoundError) and error.name in EXTRAS["train"]
        if absent or isinstance(error, InputError):
            raise
        words = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
        raise InputError(f"the policy '{spec}' {what} ({words}): check that {remedy}") from error


def _words(names: tuple[str, ...], shapes: tuple) -> str:
    return ", ".join(f"{name} {'none' if shape is None else shape}" for name, shape in zip(names, shapes, strict=True))
