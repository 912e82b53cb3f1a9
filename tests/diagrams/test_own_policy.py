"""A policy of one's own in the programs, with recall heads trained on its states; and a cloned one."""

import json

import numpy as np
import pandas as pd
import pytest

from diagrams import calibrate, pick_place, sweep
from diagrams.episodes import validation
from diagrams.episodes.record import load_record
from diagrams.episodes.rollout import Rollout
from diagrams.world.configuration import World
from diagrams.world.scenario import load_world
from models.command_line import ROOT
from models.errors import InputError
from models.files.container import WeightsError
from models.files.detectors import StoredDetector, load_detector, save_detector
from models.inference import Encoder, own_policy
from models.training import __main__ as training
from tests.diagrams import cloned_policy
from tests.diagrams.test_outside import run_episode
from tests.diagrams.untrained import save_untrained
from tests.models import synthetic
from tests.models.own_policies import DRIFT

HERE = "tests.models.own_policies"
DETECTOR = "tests.systems.outside_detector:FarFromHome"


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A folder with an encoder."""
    return save_untrained(tmp_path_factory.mktemp("own"))


@pytest.fixture(scope="module")
def data(weights):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic, "INITIAL_POSTURE", World().initial_posture)
        patch.setattr(synthetic, "WORLD", {})
        return synthetic.write(weights / "tiny.h5", grid=2, ticks=(48, 52))


@pytest.fixture(autouse=True)
def short(monkeypatch, tmp_path):
    """Runs of three seconds, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    whole = Rollout.run
    monkeypatch.setattr(Rollout, "run", lambda *given, **options: whole(*given, **{"time_limit": 3.0} | options))


def fly(weights, name, *words):
    """The record of an episode that does nothing of the task, and its outcome."""
    given = ["--policy", name if ":" in name else f"{HERE}:{name}", "--weights", weights, "--record", "run.npz"]
    cli = pick_place.parse([*map(str, given), *words])
    assert pick_place.main(cli) == 1
    return load_record(cli.record)


def test_its_posture_is_the_command(weights):
    record, outcome = fly(weights, "Drift", "--detector", "never", "--disturbance", "none")
    assert outcome["rnn"] == "drift"
    assert record.hidden_state.shape == (30, 0)
    steps = record.desired_posture - record.posture
    np.testing.assert_allclose(steps, np.tile(DRIFT * np.eye(8)[0], (30, 1)), atol=1e-12)


def test_it_flies_in_a_world_of_its_own(weights):
    iiwa = ROOT / "sdf" / "iiwa.world.yaml"
    words = ["--detector", "never", "--disturbance", "none"]
    record, _ = fly(weights, "Abroad", *words, "--world", str(iiwa))
    np.testing.assert_allclose(record.posture[0], load_world(iiwa).initial_posture)
    assert record.posture[-1, 0] > record.posture[0, 0] + 10 * DRIFT
    with pytest.raises(InputError, match=r"models is 'pick_place.* the policy 'abroad' says 'iiwa"):
        fly(weights, "Abroad", *words)
    with pytest.raises(InputError, match=r"(?s)initial posture is .* the policy 'drift' says"):
        fly(weights, "Drift", *words, "--world", str(iiwa))


def test_one_that_looks_sees_the_picture_of_the_tick(weights):
    words = ["--detector", "never", "--disturbance", "none", "--mcap", "run.mcap"]
    record, _ = fly(weights, "Looking", *words)
    assert record.predicted_features.shape == (30, 1)
    for k in record.picture_ticks[1:]:
        step = (record.desired_posture - record.posture)[k, 0]
        # The record's picture is from the middle of the tick, in which the arm moves a little.
        assert step == pytest.approx(1e-3 * record.pictures[k // 5][..., 0].mean() / 255.0, rel=1e-2)


def test_what_needs_recall_is_refused_where_there_is_none(weights):
    with pytest.raises(InputError, match="drift recalls nothing: train recall heads"):
        fly(weights, "Drift", "--disturbance", "none")
    with pytest.raises(InputError, match="no calibration of 'recall' for recalling"):
        fly(weights, "Recalling", "--disturbance", "none")
    with pytest.raises(InputError, match="no policy 'lstm'"):
        fly(weights, "x:y", "--policy", "lstm")


def calibrated(weights, monkeypatch, name, detector, *words):
    """The detector's file after calibrate.py; its episodes are made up."""
    monkeypatch.setattr(validation, "run_episode", run_episode)
    out = weights / f"{'far' if ':' in detector else detector}.safetensors"
    given = ["--policy", f"{HERE}:{name}", "--detector", detector, "--out", out, "--encoder", weights / "encoder.onnx"]
    given += ["--episodes", 4, "--disturbed", 4, "--runs", 4, "--workers", 0, "--kept", weights / f"kept-{name}"]
    assert calibrate.main(calibrate.parse([*map(str, given), *words])) == 0
    monkeypatch.undo()
    return load_detector(out, "far" if ":" in detector else detector)


def test_one_that_recalls_is_calibrated_and_flown(weights, monkeypatch, tmp_path):
    stored = calibrated(weights, monkeypatch, "Recalling", "recall")
    policy = own_policy(f"{HERE}:Recalling", weights)
    assert np.shape(stored.calibrations[policy.hash]["mean_errors"]) == (3,)
    monkeypatch.chdir(tmp_path)
    whole = Rollout.run
    monkeypatch.setattr(Rollout, "run", lambda *given, **options: whole(*given, **options, time_limit=1.0))
    record, _ = fly(weights, "Recalling", "--disturbance", "none")
    assert record.errors.shape == (10, 3)
    assert record.errors.max() < 1.0 > record.alpha.max()  # it rests where it should


def test_heads_are_trained_on_its_states_and_judge_it(weights, data, monkeypatch, tmp_path, capsys):
    words = ["--policy", f"{HERE}:Remembering", "--data", data, "--out", weights, "--encoder", weights / "encoder.onnx"]
    words += ["--steps", 400, "--horizon", 2, "--hidden", 0, "--learning-rate", 0.02, "--batch-size", 2]
    words += ["--augmentation.joint-noise", 0.02, "--augmentation.loop-probability", 0]
    assert training.main(training.parse(["recall", *map(str, words)])) == 0
    errors = [float(word) for word in capsys.readouterr().out.split("n = 1..2: ")[1].split()]
    policy = own_policy(f"{HERE}:Remembering", weights)
    assert (policy.recalls, policy.horizon, policy.name) == (True, 2, "remembering")
    demo = synthetic.demonstration(np.array([0.02, 0.0]), "left", (48, 52), images=False)[1]
    spread = policy.scaling.scale(demo)[:, :7].std(axis=0).max()
    assert max(errors) < 0.5 * spread  # of the postures: they come out of the state
    with pytest.raises(InputError, match="is there already"):
        training.main(training.parse(["recall", *map(str, words)]))
    calibrated(weights, monkeypatch, "Remembering", "recall")
    monkeypatch.chdir(tmp_path)
    whole = Rollout.run
    monkeypatch.setattr(Rollout, "run", lambda *given, **options: whole(*given, **options, time_limit=1.0))
    record, _ = fly(weights, "Remembering", "--disturbance", "none")
    assert (record.errors.shape, record.hidden_state.shape) == ((10, 3), (10, 24))
    # Heads of another policy.
    (weights / "drift-recall.onnx").write_bytes((weights / "remembering-recall.onnx").read_bytes())
    with pytest.raises(WeightsError, match="was trained on the states of another drift"):
        own_policy(f"{HERE}:Drift", weights)
    (weights / "drift-recall.onnx").unlink()


def test_no_heads_without_a_state(weights, data, tmp_path):
    for name, named in (("Drift", "'drift' has no hidden state"), ("Looking", "'looking' has no hidden state")):
        words = ["--policy", f"{HERE}:{name}", "--data", data, "--out", tmp_path, "--encoder", weights / "encoder.onnx"]
        with pytest.raises(InputError, match=named):
            training.main(training.parse(["recall", *map(str, words)]))


def test_a_sweep(weights, tmp_path):
    words = ["--policy", f"{HERE}:Drift", f"{HERE}:Looking", "--detector", "never", "--weights", weights]
    words += ["--out", tmp_path / "sweep", "--episodes", 1, "--disturbance", "none", "--workers", 1]
    assert sweep.main(sweep.parse([*map(str, words), "--until", "switching"])) == 0
    rows = pd.read_parquet(tmp_path / "sweep" / "episodes.parquet")
    assert rows.rnn.tolist() == ["drift", "looking"]
    assert rows.error.isna().all()
    assert rows.weights_hash.tolist() == [own_policy(f"{HERE}:{name}", weights).hash for name in ("Drift", "Looking")]


def test_a_network_beside_it_is_refused(weights):
    with pytest.raises(InputError, match="--rnn and --policy are given: leave one out"):
        fly(weights, "Drift", "--rnn", "gru")
    for words, named in (
        (["--rnn", "gru"], "--rnn and --policy are given"), (["--training-seeds", "1"], "--training-seeds 1 is"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=named):
            sweep.main(sweep.parse(["--policy", f"{HERE}:Drift", *words]))


def test_bad_input_is_named(weights, tmp_path):
    given = ["--encoder", str(weights / "encoder.onnx"), "--policy", f"{HERE}:Drift"]
    for words, named in (
        (["--out", "knn.safetensors", "--detector", "never"], "nothing to calibrate"),
        (["--out", "mine.safetensors", "--detector", "knn"], "call it knn.safetensors"),
        (["--out", "knn.safetensors", "--detector", "knn"], "does not exist"),
        (["--out", "recall.safetensors"], "drift recalls nothing"),
        (["--out", "x.onnx", "--candidates", "y.onnx"], "or give --policy"),
    ):
        with pytest.raises(InputError, match=named):
            calibrate.main(calibrate.parse([*given, *words]))


def test_a_cloned_policy_is_switched_by_a_detector_that_needs_no_state(weights, data, tmp_path, monkeypatch):
    """An MLP on posture and features that learned in a second: it moves as taught, and is led home where it is far."""
    cloned_policy.train(data, tmp_path / "cloned.npz", Encoder(weights / "encoder.onnx"), updates=300, hidden=32)
    monkeypatch.setenv(cloned_policy.FILE, str(tmp_path / "cloned.npz"))
    spec = "tests.diagrams.cloned_policy:Cloned"
    policy = own_policy(spec, weights)
    alone, _ = fly(weights, spec, "--detector", "never", "--disturbance", "none")
    away = np.abs(alone.posture[:, :7] - policy.initial_posture[:7]).max(axis=1)
    assert away.max() > 0.1  # rad: it moves
    far = np.abs(policy.scaling.scale(alone.posture)[:, 1])
    gamma = 0.5 * (far[0] + far.max())
    assert far.max() > 1.2 * far[0]
    stored = StoredDetector("far", {"largest": np.array([1.0])})
    stored.calibrations[policy.hash] = {"mean_errors": [1.0], "beta": 1000.0, "gamma": gamma}
    save_detector(weights / "far.safetensors", stored)
    record, outcome = fly(weights, spec, "--detector", DETECTOR, "--disturbance", "none", "--json", "o.json")
    assert json.loads((tmp_path / "o.json").read_text())["detector"] == "far"
    noticed = int(np.argmax(record.alpha > 0.9))
    assert outcome["switched"]
    assert 0 < noticed == int(np.argmax(np.abs(policy.scaling.scale(record.posture)[:, 1]) > gamma))
    # From there the LQR has it, while it is far.
    pull = record.regulator_step[noticed, :7]
    np.testing.assert_allclose((record.desired_posture - record.posture)[noticed, :7], pull, atol=1e-3)
    judged = np.abs(policy.scaling.scale(record.posture)[:, 1])
    assert judged[noticed + 1 : noticed + 4].min() < judged[noticed]
    assert judged[noticed:].max() < 0.5 * (gamma + far.max())  # where it goes if left alone
