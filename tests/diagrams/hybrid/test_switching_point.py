"""The one-tick map: by hand and by finite differences; Newton and decay on maps that are known."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from diagrams.hybrid.switching_point import (
    OneTickMap,
    SubtaskImage,
    analyse,
    measure_decay,
    nearest_fixed_point,
    newton,
    save_spectra,
    subtask_images,
)
from models.errors import InputError
from models.files.weights import load_policy
from models.networks.recall import RecallHeads
from models.networks.rnn import make_rnn
from tests.diagrams.untrained import save_untrained

PNG = b"\x89PNG\r\n\x1a\n"
FEATURES = np.linspace(-0.5, 0.5, 30)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    return load_policy(save_untrained(tmp_path_factory.mktemp("weights")) / "lstm.safetensors")


def small(stored, name):
    """The stored policy with another untrained network."""
    torch.manual_seed(1)
    rnn = make_rnn(name).eval()
    return replace(stored, rnn=rnn, recall=RecallHeads(rnn.state_size, 8))


def test_images_of_both_subtasks(world, encoder):
    first, second = subtask_images(world, encoder, (0.53, 0.0), "left")
    assert (first.subtask, second.subtask) == (1, 2)
    # The can is on the mat, then in the hand.
    assert (first.features[1], second.features[1]) == (1.0, 0.0)
    assert np.array_equal(first.posture, world.initial_posture)
    assert second.posture[-1] == world.closed_opening


def test_one_tick_by_hand(world, stored):
    loop = OneTickMap(world, stored, FEATURES)
    rng = np.random.default_rng(0)
    home = stored.scaling.scale(world.initial_posture)
    hidden, posture = 0.1 * rng.normal(size=500), home + 0.05 * rng.normal(size=8)
    after = loop(loop.join(hidden, posture))
    x = torch.tensor(np.concatenate((posture, FEATURES)), dtype=torch.float32)[None]
    with torch.no_grad():
        y, c = stored.rnn.step(x, torch.tensor(hidden, dtype=torch.float32)[None])
    assert after[:500] == pytest.approx(c[0].numpy(), abs=1e-5)
    expected = y[0, :8].numpy() - np.append(0.1 * (posture - home)[:7], 0.0)
    assert after[500:507] == pytest.approx(expected[:7], abs=1e-5)
    # The opening cannot be larger than the fingers'.
    assert after[507] == pytest.approx(min(expected[7], stored.scaling.scale(np.full(8, 0.08))[7]), abs=1e-5)


@pytest.mark.parametrize("name", ["gru", "mtrnn"])
def test_jacobian_agrees_with_finite_differences(world, stored, name):
    loop = OneTickMap(world, small(stored, name), FEATURES)
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


def test_newton_finds_the_root():
    """x+ = cos x has one fixed point, 0.7390851332151607."""
    found = newton(np.cos, lambda z: -np.diag(np.sin(z)), np.array([3.0]))
    assert found.converged
    assert found.z[0] == pytest.approx(0.7390851332151607, abs=1e-12)


def test_where_there_is_no_fixed_point_it_is_said():
    """x+ = x + x^2 + 0.01 moves on everywhere, most slowly at 0."""
    found = newton(lambda z: z + z**2 + 0.01, lambda z: np.diag(1 + 2 * z), np.array([1.0]))
    assert not found.converged
    assert found.residual == pytest.approx(0.01, rel=0.1)


def test_the_nearest_of_several_is_taken():
    """x+ = x - sin(x) / 2: attracting at 0, repelling at pi."""
    step, jacobian = lambda z: z - np.sin(z) / 2, lambda z: np.diag(1 - np.cos(z) / 2)
    assert nearest_fixed_point(step, jacobian, np.array([0.4]), 1).z[0] == pytest.approx(0.0, abs=1e-9)
    assert nearest_fixed_point(step, jacobian, np.array([3.0]), 1).z[0] == pytest.approx(np.pi, abs=1e-9)


@pytest.mark.parametrize("radius", [0.6, 0.95, 1.08])
def test_decay_of_a_rotation(radius):
    """A turn by 20 deg a tick that shrinks (or grows) by `radius`, beside something faster."""
    angle = np.deg2rad(20.0)
    A = np.zeros((3, 3))
    A[:2, :2] = radius * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    A[2, 2] = 0.3 * radius
    measured, norms = measure_decay(lambda z: A @ z, np.zeros(3), radius, np.random.default_rng(0))
    assert measured == pytest.approx(radius, rel=1e-3)
    assert norms[0] == pytest.approx(1e-5)


def test_analysis_of_a_network(world, stored, tmp_path):
    image = SubtaskImage(1, FEATURES, world.initial_posture)
    found, picture = analyse(world, small(stored, "mtrnn"), image, samples=3, seed=0)
    assert found["kind"] == "fixed point"
    assert found["residual"] < 1e-11
    assert found["jacobian_error"] < 1e-5
    assert found["decay_error"] < 0.1
    assert found["spectral_radius"] == pytest.approx(np.hypot(*found["eigenvalues"][0]))
    json.dumps(found, allow_nan=False)
    save_spectra([("title", picture)], tmp_path / "linearize.png")
    assert (tmp_path / "linearize.png").read_bytes().startswith(PNG)


def test_candidates_without_recall_heads_have_no_alpha(world, stored):
    candidate = replace(small(stored, "mtrnn"), recall=None)
    found, _ = analyse(world, candidate, SubtaskImage(1, FEATURES, world.initial_posture), samples=1, seed=0)
    assert found["alpha"] is None
