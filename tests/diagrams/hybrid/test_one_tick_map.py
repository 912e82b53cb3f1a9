"""The one-tick map: by hand and by finite differences."""

import numpy as np
import pytest
import torch

from diagrams.hybrid.one_tick_map import OneTickMap
from models.errors import InputError
from tests.diagrams.hybrid.hybrid_fakes import FEATURES, small_policy


def test_one_tick_by_hand(world, stored):
    loop = OneTickMap(world, stored, FEATURES)
    rng = np.random.default_rng(0)
    home = stored.scaling.scale(world.initial_posture)
    hidden, posture = 0.1 * rng.normal(size=500), home + 0.05 * rng.normal(size=8)
    after = loop(np.concatenate((hidden, posture)))
    x = torch.tensor(np.concatenate((posture, FEATURES)), dtype=torch.float32)[None]
    with torch.no_grad():
        y, c = stored.rnn.step(x, torch.tensor(hidden, dtype=torch.float32)[None])
    assert after[:500] == pytest.approx(c[0].numpy(), abs=1e-5)
    # At alpha = 0 the arm goes to the predicted posture, whatever the LQR would do; the fingers are open or closed.
    speed = np.array([100.0] * 7)  # none is reached
    assert np.abs(y[0, :7].numpy() - posture[:7]).max() < speed.max()
    assert after[500:507] == pytest.approx(y[0, :7].numpy(), abs=1e-5)


@pytest.mark.parametrize("name", ["gru", "mtrnn"])
def test_jacobian_agrees_with_finite_differences(world, stored, name):
    loop = OneTickMap(world, small_policy(stored, name), FEATURES)
    rng = np.random.default_rng(0)
    z = np.concatenate((0.3 * rng.normal(size=loop.state_size), 0.1 * rng.normal(size=8)))
    J = loop.jacobian(z)
    assert np.abs(J - loop.difference_jacobian(z)).max() < 1e-8
    # Through the regulator alone: -0.1 of the posture, but none of the fingers'.
    with torch.no_grad():
        loop.rnn.output.weight.zero_()
    own = loop.jacobian(z)[-8:, -8:]
    assert own == pytest.approx(np.diag(np.append(np.full(7, -0.1), 0.0)), abs=1e-9)


def test_features_of_another_size_are_refused(world, stored):
    with pytest.raises(InputError, match="3 features do not fit"):
        OneTickMap(world, stored, np.zeros(3))
