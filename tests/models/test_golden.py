"""The committed networks compute what they computed when they were committed.

After weights were exchanged on purpose: `python tests/models/test_golden.py` writes the numbers anew.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from models.files.detectors import calibration_of, load_detector
from models.inference import Encoder, Policy
from models.networks import NETWORKS

WEIGHTS = Path(__file__).resolve().parents[2] / "models" / "weights"
GOLDEN = Path(__file__).with_name("golden.json")
# Not the autoencoder, nor the detectors that diagrams/baselines.py puts beside the networks.
POLICIES = sorted(path.stem for path in WEIGHTS.glob("*.safetensors") if path.stem.split("-")[0] in list(NETWORKS))


def encoder_output() -> np.ndarray:
    """(30,) features of a picture of coloured blocks."""
    blocks = np.random.default_rng(0).integers(0, 256, (14, 14, 3), dtype=np.uint8)
    return Encoder(WEIGHTS / "cae.safetensors").encode(np.kron(blocks, np.ones((8, 8, 1), np.uint8)))


def policy_output(name: str) -> np.ndarray:
    """Prediction and recall, one row of numbers, after five ticks on fixed inputs."""
    policy = Policy(WEIGHTS / f"{name}.safetensors")
    rng, state = np.random.default_rng(1), policy.initial_state
    for _ in range(5):
        y, state = policy.step(rng.uniform(-0.8, 0.8, policy.posture_size + policy.feature_size), state)
    return np.concatenate([y, policy.recall(state).ravel()])


def test_every_committed_network_has_its_numbers() -> None:
    assert set(json.loads(GOLDEN.read_text())) == {"cae", *POLICIES}
    assert "lstm" in POLICIES


def test_encoder() -> None:
    np.testing.assert_allclose(encoder_output(), json.loads(GOLDEN.read_text())["cae"], rtol=0, atol=2e-4)


@pytest.mark.parametrize("name", POLICIES)
def test_policy(name: str) -> None:
    np.testing.assert_allclose(policy_output(name), json.loads(GOLDEN.read_text())[name], rtol=0, atol=1e-5)


@pytest.mark.parametrize("method", ["knn", "subspace"])
def test_committed_detectors_are_calibrated_for_the_committed_lstms(method: str) -> None:
    path = WEIGHTS / f"{method}.safetensors"
    stored = load_detector(path, method)
    for name in (name for name in POLICIES if name.startswith("lstm")):
        assert calibration_of(path, stored, Policy(WEIGHTS / f"{name}.safetensors").hash)["gamma"] > 1.0


def test_weights_stay_within_the_limit() -> None:
    assert sum(path.stat().st_size for path in WEIGHTS.iterdir()) <= 45_000_000
    assert all(path.suffix in (".safetensors", ".md") for path in WEIGHTS.iterdir())


if __name__ == "__main__":
    outputs = {"cae": encoder_output(), **{name: policy_output(name) for name in POLICIES}}
    GOLDEN.write_text(json.dumps({k: np.round(v, 6).tolist() for k, v in outputs.items()}) + "\n")
