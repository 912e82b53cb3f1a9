"""Checks of constructor arguments: each error names the value, the limit and the remedy."""

import math

import numpy as np

from models.errors import InputError


def require_count(name: str, value: int, minimum: int = 1, maximum: int | None = None) -> int:
    """Returns `value` as an int; raises ValueError unless it is a whole number from `minimum` to `maximum`."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or value < minimum or (maximum is not None and value > maximum):
        limit = f"at least {minimum}" + ("" if maximum is None else f" and at most {maximum}")
        raise ValueError(f"{name} is {value!r}; it must be a whole number of {limit}: pass such a number.")
    return int(value)


def require_positive(name: str, value: float) -> float:
    """Returns `value` as a float; raises ValueError unless it is finite and > 0."""
    if not math.isfinite(value) or value <= 0:
        raise ValueError(f"{name} is {value!r}; it must be finite and greater than 0: pass such a number.")
    return float(value)


def require_vector(name: str, value, size: int, *, minimum: float | None = None) -> np.ndarray:
    """Returns a float copy of `value`; raises ValueError unless its shape is (size,), all finite and >= `minimum`."""
    vector = np.array(value, dtype=float)
    if vector.shape != (size,):
        raise ValueError(f"{name} has shape {vector.shape}; it must have shape ({size},): pass one number a component.")
    if not np.all(np.isfinite(vector)):
        raise ValueError(f"{name} is {vector}; every component must be finite: remove NaN and infinite values.")
    if minimum is not None and np.any(vector < minimum):
        raise ValueError(f"{name} is {vector}; every component must be at least {minimum}: raise the smaller ones.")
    return vector


def require_bounds(lower_name: str, lower, upper_name: str, upper, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns `lower` and `upper`, shape (size,) each; raises ValueError unless lower < upper in every component."""
    lower, upper = require_vector(lower_name, lower, size), require_vector(upper_name, upper, size)
    if np.any(lower >= upper):
        raise ValueError(
            f"{lower_name} is {lower} and {upper_name} is {upper}; {lower_name} must be less than {upper_name} in "
            f"every component: swap or widen component(s) {np.flatnonzero(lower >= upper).tolist()}."
        )
    return lower, upper


def require_arrays(arrays: dict, *names: str) -> None:
    """Raises InputError unless the arrays of a detector's file have these `names`."""
    if set(arrays) != set(names):
        raise InputError(f"it holds {sorted(arrays)}, where {sorted(names)} are needed: fit it again")
