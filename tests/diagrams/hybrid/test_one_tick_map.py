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
    hidden, posture = (
        0.1 * rng.normal(size=500),
        stored.scaling.scale(world.initial_posture) + 0.05 * rng.normal(size=8),
    )
    after = loop(np.concatenate((hidden, posture)))
    x = torch.tensor(np.concatenate((posture, FEATURES)), dtype=torch.float32)[None]
    with torch.no_grad():
        y, c = stored.rnn.step(x, torch.tensor(hidden, dtype=torch.float32)[None])
    assert after[:500] == pytest.approx(c[0].numpy(), abs=1e-5)
    # At alpha = 0 the arm goes to the predicted posture, whatever the LQR would do; the fingers are open or closed.
    assert after[500:507] == pytest.approx(y[0, :7].numpy(), abs=1e-5)
    assert stored.scaling.unscale(y[0, :8].numpy())[7] > 0.065
    assert stored.scaling.unscale(after[500:])[7] == pytest.approx(0.08)


@pytest.mark.parametrize("name", ["gru", "mtrnn"])
def test_jacobian_agrees_with_finite_differences(world, stored, name):
    loop = OneTickMap(world, small_policy(stored, name), FEATURES)
    rng = np.random.default_rng(0)
    z = np.concatenate((0.3 * rng.normal(size=loop.state_size), 0.1 * rng.normal(size=8)))
    J = loop.jacobian(z)
    assert np.abs(J - loop.difference_jacobian(z)).max() < 1e-8
    # The joints' rows are those of the prediction, whatever the LQR would do.
    S = loop.state_size

    def prediction(z):
        x = torch.cat((z[S:], torch.tensor(FEATURES)))
        return loop.rnn.step(x[None], z[None, :S])[0][0, :8]

    expected = torch.autograd.functional.jacobian(prediction, torch.from_numpy(z)).numpy()
    assert J[S : S + 7] == pytest.approx(expected[:7], abs=1e-12)


@pytest.mark.parametrize(("opening", "expected", "slope"), [(0.07, 0.08, 0.0), (0.055, 0.05, 1.0), (0.04, 0.03, 0.0)])
def test_fingers_are_a_step(world, stored, opening, expected, slope):
    """Predicted 70, 55, 40 mm; commanded so far 50 mm."""
    loop = OneTickMap(world, small_policy(stored, "gru"), FEATURES)
    with torch.no_grad():
        loop.rnn.output.weight.zero_()
        loop.rnn.output.bias[7] = (opening - 0.08) / 0.06  # scaled by the fixture's 0.06 m about 0.08 m
    z = np.append(np.zeros(loop.state_size + 7), (0.05 - 0.08) / 0.06)
    assert stored.scaling.unscale(loop(z)[-8:])[7] == pytest.approx(expected)
    assert loop.jacobian(z)[-1] == pytest.approx(np.append(np.zeros(loop.state_size + 7), slope))


def test_features_of_another_size_are_refused(world, stored):
    with pytest.raises(InputError, match="3 features do not fit"):
        OneTickMap(world, stored, np.zeros(3))
