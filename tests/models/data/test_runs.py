"""Tapes as rows, and arrays of several networks in one file."""

import numpy as np

from models.data.runs import Tape, fitted_for, of_policy, rows_of


def tape(ticks, start):
    def numbers(*shape):
        return start + np.arange(np.prod((ticks, *shape)), dtype=float).reshape(ticks, *shape)

    return Tape(numbers(2), numbers(3, 2), numbers(4), numbers(1), numbers(1), numbers())


def test_rows_are_the_ports_side_by_side_run_after_run():
    rows = rows_of([tape(2, 0.0), tape(1, 100.0)], "features", "recalled_postures")
    assert rows.tolist() == [[0.0, *range(6)], [1.0, *range(6, 12)], [100.0, *range(100, 106)]]


def test_each_network_has_its_own_arrays():
    one, two = {"mean": np.zeros(1)}, {"mean": np.ones(1)}
    stored = fitted_for("a" * 64, one) | fitted_for("b" * 64, two) | {"windows": np.full(1, 7.0)}
    assert len(stored) == 3
    found = of_policy("b" * 64, stored)
    assert {name: array.tolist() for name, array in found.items()} == {"mean": [1.0], "windows": [7.0]}
    assert set(of_policy("c" * 64, stored)) == {"windows"}
