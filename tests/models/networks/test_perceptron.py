"""Small perceptrons: by hand, learned, kept as arrays."""

import numpy as np
import pytest

from models.networks.perceptron import of_arrays, random_layers, run_perceptron, to_arrays, train_perceptron


def test_by_hand():
    layers = [(np.array([[1.0, -1.0], [2.0, 0.0]]), np.array([0.0, -1.0])), (np.array([[3.0, 5.0]]), np.array([0.5]))]
    # (1, 2): (-1, 1) by ReLU (0, 1), then 5.5; (2, 0): (2, 3), then 6 + 15 + 0.5.
    assert run_perceptron(layers, np.array([[1.0, 2.0], [2.0, 0.0]])) == pytest.approx(np.array([[5.5], [21.5]]))


def test_it_learns_and_the_same_seed_gives_the_same_bits():
    def batch(rng):
        rows = rng.uniform(-1.0, 1.0, (64, 2))
        return rows, np.abs(rows[:, :1] - rows[:, 1:])

    start = random_layers((2, 16, 1), np.random.default_rng(0))
    trained, again, other = (train_perceptron(start, batch, 150, seed=s, rate=1e-2) for s in (0, 0, 1))
    rows, targets = batch(np.random.default_rng(9))
    assert np.square(run_perceptron(trained, rows) - targets).mean() < 0.03
    assert np.square(run_perceptron(start, rows) - targets).mean() > 0.05  # what is given is left as it was
    bits = [b"".join(array.tobytes() for layer in layers for array in layer) for layers in (trained, again, other)]
    assert bits[0] == bits[1] != bits[2]


def test_arrays_come_back_and_others_are_refused():
    layers = random_layers((3, 4, 2), np.random.default_rng(0))
    arrays = to_arrays("net", layers)
    assert sorted(arrays) == ["net.0.bias", "net.0.weights", "net.1.bias", "net.1.weights"]
    for (weights, bias), (w, b) in zip(layers, of_arrays("net", arrays), strict=True):
        assert np.array_equal(weights, w)
        assert np.array_equal(bias, b)
    for wrong in ({}, arrays | {"net.1.weights": np.zeros((2, 5))}, arrays | {"net.0.bias": np.zeros(3)}):
        with pytest.raises(ValueError, match="fit again"):
            of_arrays("net", wrong)
