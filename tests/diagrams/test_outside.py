"""A network and a detector of another package: training, calibration, an episode and a sweep, by their specs."""

import json
from functools import partialmethod

import numpy as np
import pandas as pd
import pytest

from diagrams import baselines, calibrate, pick_place, sweep
from diagrams.episodes import validation
from diagrams.episodes.rollout import Rollout
from diagrams.world.configuration import World
from models.files.weights import load_policy
from models.training import __main__ as training
from tests.diagrams.episode_fakes import outcome, record
from tests.diagrams.untrained import save_untrained
from tests.models import synthetic

NETWORK, DETECTOR = "tests.models.outside:Elman", "tests.systems.outside_detector:FarFromHome"


def run_episode(job):
    """Made up, since networks of two updates finish no task: normal errors of 1, disturbed ones of 100."""
    criteria = len(job.controller.calibration.mean_errors)
    rng = np.random.default_rng(job.seed)
    normal = rng.uniform(0.5, 1.0, (20, criteria))
    return outcome(job), record(normal, [] if job.kind == "none" else 100 * normal, 20 * (job.kind != "none"))


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A folder with the untrained autoencoder, and with what the trainings and calibrations write."""
    folder = save_untrained(tmp_path_factory.mktemp("outside"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic, "INITIAL_POSTURE", World().initial_posture)
        patch.setattr(synthetic, "WORLD", {})
        patch.setattr(validation, "run_episode", run_episode)
        data = synthetic.write(folder / "tiny.h5", grid=2, ticks=(48, 52))
        common = ["--data", str(data), "--out", str(folder / "run"), "--encoder", str(folder / "encoder.onnx")]
        small = ["--steps", "2"]
        for command in (
            ["rnn", "--rnn", NETWORK, *common, *small],
            ["recall", "--policy", str(folder / "run" / "rnn-2.onnx"), *common, *small],
        ):
            assert training.main(training.parse(command)) == 0
        episodes = [
            "--encoder",
            str(folder / "encoder.onnx"),
            "--episodes",
            "4",
            "--disturbed",
            "4",
            "--workers",
            "0",
        ]
        out = ["--candidates", str(folder / "run" / "policy-2.onnx"), "--out", str(folder / "elman.onnx")]
        kept = ["--runs", "4", "--kept", str(folder / "kept")]
        assert calibrate.main(calibrate.parse([*out, *episodes, *kept])) == 0
        fitted = ["--policies", str(folder / "elman.onnx"), "--data", str(data), "--detector", DETECTOR]
        assert baselines.main(baselines.parse([*fitted, *episodes, "--trials", "1"])) == 0
    return folder


def test_it_is_trained_and_calibrated(weights):
    stored = load_policy(weights / "elman.onnx")
    assert (stored.rnn.name, stored.rnn.spec) == ("elman", NETWORK)
    assert 1.0 < stored.gamma < 2.0  # the largest of 20 errors, by their mean, in four runs
    assert (weights / "far.safetensors").is_file()


def test_one_episode(weights, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Rollout, "run", partialmethod(Rollout.run, time_limit=1.0))
    words = [
        "--rnn",
        NETWORK,
        "--detector",
        DETECTOR,
        "--weights",
        str(weights),
        "--disturbance",
        "none",
        "--json",
        "o.json",
    ]
    assert pick_place.main(pick_place.parse(words)) == 1  # nothing is done in a second
    found = json.loads((tmp_path / "o.json").read_text())
    assert (found["rnn"], found["detector"], found["sim_seconds"]) == ("elman", "far", 1.0)


def test_a_sweep(weights, tmp_path):
    words = ["--rnn", NETWORK, "--detector", DETECTOR, "recall", "--weights", str(weights), "--out", str(tmp_path)]
    assert sweep.main(sweep.parse([*words, "--episodes", "1", "--disturbance", "none", "--workers", "2"])) == 0
    rows = pd.read_parquet(tmp_path / "episodes.parquet")
    assert list(zip(rows.rnn, rows.detector, strict=True)) == [("elman", "far"), ("elman", "recall")]
    assert rows.error.isna().all()
