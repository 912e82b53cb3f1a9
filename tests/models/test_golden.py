"""The committed networks compute what they computed when they were committed.

After weights were exchanged on purpose: `python tests/models/test_golden.py` writes the numbers anew.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from models.files.detectors import calibration_of, load_detector
from models.inference import Decoder, Encoder, Policy
from models.networks import NETWORKS

WEIGHTS = Path(__file__).resolve().parents[2] / "models" / "weights"
GOLDEN = Path(__file__).with_name("golden.json")
POLICIES = sorted(
    str(path.relative_to(WEIGHTS).with_suffix(""))
    for path in WEIGHTS.rglob("*.onnx")
    if path.stem.split("-")[0] in list(NETWORKS)
)
# The same bits on one processor; on another, 8-bit sums may be rounded elsewhere.
TOLERANCE = {"encoder": 0.02, "iiwa/encoder": 0.02, "decoder": 2.0}


def encoder_output(name: str) -> np.ndarray:
    """(30,) features of a picture of coloured blocks."""
    blocks = np.random.default_rng(0).integers(0, 256, (14, 14, 3), dtype=np.uint8)
    return Encoder(WEIGHTS / f"{name}.onnx").encode(np.kron(blocks, np.ones((8, 8, 1), np.uint8)))


def decoder_output() -> np.ndarray:
    """(48,) of a picture made from fixed features."""
    features = np.random.default_rng(2).uniform(-0.8, 0.8, 30)
    return Decoder(WEIGHTS / "decoder.onnx").decode(features)[::28, ::28].ravel().astype(float)


def policy_output(name: str) -> np.ndarray:
    """Prediction and recall, one row of numbers, after five ticks on fixed inputs."""
    policy = Policy(WEIGHTS / f"{name}.onnx")
    rng, state = np.random.default_rng(1), policy.initial_state
    for _ in range(5):
        y, state, recalled = policy.step(rng.uniform(-0.8, 0.8, policy.posture_size + policy.feature_size), state)
    return np.concatenate([y, recalled.ravel()])


def test_every_committed_network_has_its_numbers() -> None:
    assert set(json.loads(GOLDEN.read_text())) == {*TOLERANCE, *POLICIES}
    assert len(POLICIES) == 9 + 1


def outputs() -> dict[str, np.ndarray]:
    found = {name: encoder_output(name) for name in ("encoder", "iiwa/encoder")} | {"decoder": decoder_output()}
    return found | {name: policy_output(name) for name in POLICIES}


def test_every_network_computes_what_it_did() -> None:
    golden = json.loads(GOLDEN.read_text())
    for name, numbers in outputs().items():
        np.testing.assert_allclose(numbers, golden[name], rtol=0, atol=TOLERANCE.get(name, 1e-5), err_msg=name)


@pytest.mark.parametrize("path", [WEIGHTS / "knn.safetensors", WEIGHTS / "subspace.safetensors"], ids=lambda p: p.stem)
def test_committed_detectors_are_calibrated_for_the_committed_lstms(path: Path) -> None:
    stored = load_detector(path, path.stem)
    for name in ("lstm", "lstm-1", "lstm-2"):
        assert calibration_of(path, stored, Policy(WEIGHTS / f"{name}.onnx").hash)["gamma"] > 1.0


def test_the_committed_cusum_is_calibrated_for_the_default_network() -> None:
    path = WEIGHTS / "innovation_cusum.safetensors"
    stored, policy = load_detector(path, path.stem), Policy(WEIGHTS / "lstm.onnx")
    # Of its 299 undisturbed runs none is above gamma, of its disturbed ones all are.
    found, scores = calibration_of(path, stored, policy.hash), stored.metadata[policy.hash]["calibration"]["scores"]
    assert max(scores["none"]) == found["gamma"] < min(scores["A"] + scores["B"])
    assert len(scores["none"]) == 299


def test_weights_stay_within_the_limit() -> None:
    for folder, limit in ((WEIGHTS, 45_000_000), (WEIGHTS / "iiwa", 20_000_000)):
        files = [path for path in folder.iterdir() if path.is_file()]
        assert 0 < sum(path.stat().st_size for path in files) <= limit
        assert {path.suffix for path in files} <= {".onnx", ".safetensors", ".md"}  # no pickle; the cards
    assert [path.name for path in WEIGHTS.iterdir() if path.is_dir()] == ["iiwa"]


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps({name: np.round(v, 6).tolist() for name, v in outputs().items()}) + "\n")
