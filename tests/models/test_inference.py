from pathlib import Path

import numpy as np
import pytest
import torch

from models.files.weights import file_hash, load_autoencoder, load_policy, save_policy
from models.inference import Encoder, Policy
from models.networks.cae import to_image
from tests.models.conftest import make_policy


def test_encoder_is_the_torch_module_on_the_stored_weights(encoder_file: Path, pictures: np.ndarray) -> None:
    encoder, (model, _) = Encoder(encoder_file), load_autoencoder(encoder_file)
    with torch.inference_mode():
        wanted = model.encode(to_image(torch.from_numpy(pictures))).double().numpy()
    assert np.abs(wanted).max() > 0.1
    one_by_one = np.stack([encoder.encode(picture) for picture in pictures])
    # float32 sums of 18,432 terms, whose order depends on the processor: 2.5e-5 was seen.
    np.testing.assert_allclose(one_by_one, wanted, atol=1e-4)
    np.testing.assert_allclose(encoder.encode_batch(pictures, batch=3), wanted, atol=2e-5)
    assert one_by_one.dtype == np.float64
    np.testing.assert_array_equal(encoder.encode(pictures[0]), encoder.encode(pictures[0]))


def test_encoder_says_what_it_is(encoder_file: Path) -> None:
    encoder = Encoder(encoder_file)
    assert (encoder.feature_size, encoder.hash) == (30, file_hash(encoder_file))


def test_encoder_takes_a_view_and_refuses_other_sizes(encoder_file: Path, pictures: np.ndarray) -> None:
    encoder = Encoder(encoder_file)
    rgba = np.concatenate([pictures[0], np.full((112, 112, 1), 255, np.uint8)], axis=2)
    np.testing.assert_array_equal(encoder.encode(rgba[..., :3]), encoder.encode(pictures[0]))
    with pytest.raises(ValueError, match="uint8"):
        encoder.encode(pictures[0].astype(float))
    with pytest.raises(ValueError, match="112"):
        encoder.encode(pictures[0, :64])


@pytest.mark.parametrize("name", ["lstm", "gru", "mtrnn"])
def test_policy_is_the_torch_module(tmp_path: Path, name: str) -> None:
    path = tmp_path / "p.safetensors"
    save_policy(path, make_policy(name))
    stored, policy = load_policy(path), Policy(path)  # only what was stored counts: it is rounded to 16 bits
    rng = np.random.default_rng(0)
    x, state = rng.normal(size=38), rng.normal(size=policy.state_size)
    y, after = policy.step(x, state)
    with torch.no_grad():
        wanted = stored.rnn.step(torch.tensor(x).float()[None], torch.tensor(state).float()[None])
        recalled = stored.recall(torch.tensor(after).float()[None])
    np.testing.assert_array_equal(y, wanted[0][0].double().numpy())
    np.testing.assert_array_equal(after, wanted[1][0].double().numpy())
    np.testing.assert_array_equal(policy.recall(after), recalled[0].double().numpy())
    assert policy.recall(after).shape == (10, 8)


def test_policy_s_attributes(tmp_path: Path) -> None:
    path = tmp_path / "p.safetensors"
    save_policy(path, make_policy())
    policy = Policy(path)
    assert (policy.posture_size, policy.feature_size, policy.state_size, policy.horizon) == (8, 30, 500, 10)
    assert policy.initial_state.shape == (500,)
    assert not policy.initial_state.any()
    assert policy.mean_errors is None
    assert policy.beta is None
    assert policy.gamma is None
    assert policy.regulator_gain == 0.1
    assert policy.hash == file_hash(path)
    assert policy.initial_posture.shape == (8,)
