"""Elementwise mathematics that is the same for float, AutoDiffXd and Expression arrays.

Drake's Python arrays of AutoDiffXd and Expression have dtype object; numpy's clip and exp do not take Expressions.
"""

import numpy as np
from pydrake.math import exp as drake_exp
from pydrake.math import max as drake_max
from pydrake.math import min as drake_min


def clamp(x: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Returns min(max(x, lower), upper) elementwise; all of shape (n,), any scalar type for `x`, float bounds."""
    if x.dtype != object:
        # Twice as fast as np.clip on a handful of numbers.
        return np.minimum(np.maximum(x, lower), upper)
    scalar = type(x[0])
    clamped = [drake_min(drake_max(v, scalar(lo)), scalar(hi)) for v, lo, hi in zip(x, lower, upper, strict=True)]
    return np.array(clamped, dtype=object)


def sigmoid(x: np.ndarray) -> np.ndarray:
    """Returns 1 / (1 + exp(-x)) elementwise, shape (n,), any scalar type; no overflow for any x."""
    limit = np.full(x.shape, 500.0)  # exp(500) is finite; 1 / (1 + exp(500)) is 0 to every purpose
    x = clamp(x, -limit, limit)
    if x.dtype != object:
        return 1.0 / (1.0 + np.exp(-x))
    return np.array([1.0 / (1.0 + drake_exp(-v)) for v in x], dtype=object)


def maximum(x: np.ndarray):
    """Returns the largest component of `x`, shape (n,), any scalar type."""
    if x.dtype != object:
        return np.max(x)
    largest = x[0]
    for value in x[1:]:
        largest = drake_max(largest, value)
    return largest
