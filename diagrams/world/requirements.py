"""The requirements of requirements.stl: what they look at, and what a run makes of them."""

import functools
from pathlib import Path

import numpy as np

from systems.signal_logic import Formula, holds, robustness
from systems.signal_logic_text import load_requirements

FILE = Path(__file__).with_name("requirements.stl")
SIGNALS = ("alpha", "active", "home", "crossings", "clearance", "position_margin", "speed_margin")


@functools.cache
def requirements(period: float) -> dict[str, Formula]:
    """Those in FILE, by name, for ticks of `period` s; raises InputError where something in it does not fit."""
    return load_requirements(FILE, SIGNALS, period)


def robustness_of(signals: np.ndarray, period: float) -> dict[str, float]:
    """By how much a run keeps each requirement, in the unit of its signals; negative: it is broken.

    `signals`: (n, 7) a row a tick, as RequirementSignals gives them; `period`: of the ticks, s.
    """
    columns = dict(zip(SIGNALS, signals.T, strict=True))
    return {name: float(robustness(formula, columns)[0]) for name, formula in requirements(period).items()}


def broken(signals: np.ndarray, period: float) -> list[str]:
    """Names of the requirements that a run breaks; as `robustness_of`, and exact where that is 0."""
    columns = dict(zip(SIGNALS, signals.T, strict=True))
    return [name for name, formula in requirements(period).items() if not holds(formula, columns)[0]]
