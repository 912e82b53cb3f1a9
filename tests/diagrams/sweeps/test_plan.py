"""What is planned, and which weight files are refused before anything runs."""

import shutil

import pytest

from diagrams.sweeps.plan import SweepArguments, plan
from diagrams.world.configuration import World
from models.errors import InputError
from models.files.container import WeightsError, file_hash
from tests.diagrams.untrained import save_untrained


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return save_untrained(tmp_path_factory.mktemp("weights"))


def test_every_combination_once_with_its_files(weights):
    asked = SweepArguments(episodes=2, disturbance=["none", "A", "none"], gamma=[3.0, 3.0, 20.0], weights=weights)
    tasks, names = plan(asked, World())
    assert [(t.gamma, t.disturbance, t.seed - 2_000_000) for t in tasks] == [
        (gamma, kind, i) for gamma in (3.0, 20.0) for kind in ("none", "A") for i in (0, 1)
    ]
    assert {t.calibration.gamma for t in tasks if t.gamma == 3.0} == {3.0}
    assert {t.weights_hash for t in tasks} == {file_hash(weights / "lstm.onnx")}
    assert {t.encoder_hash for t in tasks} == {file_hash(weights / "encoder.onnx")}
    assert names == ["encoder.onnx", "lstm.onnx"]


def test_another_recovery_makes_other_episodes(weights):
    def planned(**given):
        (task,), _ = plan(SweepArguments(episodes=1, disturbance=["A"], weights=weights, **given), World())
        return task

    shipped, other = planned(), planned(recovery="backoff")
    assert (shipped.recovery, other.recovery) == ("planned", "backoff")
    assert shipped.key == planned(recovery="planned").key == other.key.replace("recall-backoff", "recall")
    assert shipped.key != other.key


def test_a_file_under_another_name_is_no_other_network(tmp_path, weights):
    for name in ("encoder", "lstm"):
        shutil.copy(weights / f"{name}.onnx", tmp_path)
    for name in ("gru", "lstm-1"):
        shutil.copy(weights / "lstm.onnx", tmp_path / f"{name}.onnx")
    with pytest.raises(InputError, match=r"gru.onnx.*holds the network 'lstm', not 'gru'"):
        plan(SweepArguments(weights=tmp_path, rnn=["gru"]), World())
    with pytest.raises(WeightsError, match=r"lstm-1.onnx.*is the same file as lstm.onnx"):
        plan(SweepArguments(weights=tmp_path, training_seeds=[0, 1]), World())


def test_another_autoencoder_or_world_than_in_training_is_refused(tmp_path, weights):
    save_untrained(tmp_path, encoder_hash="another")
    with pytest.raises(WeightsError, match="was trained with another encoder"):
        plan(SweepArguments(weights=tmp_path), World())
    with pytest.raises(InputError, match=r"closed opening is 0.02, the network was trained with 0.03"):
        plan(SweepArguments(weights=weights), World(closed_opening=0.02))


def test_two_with_one_name_are_refused(weights):
    asked = SweepArguments(rnn=["lstm", "models.networks.rnn:LSTM"], weights=weights)
    with pytest.raises(InputError, match=r"lstm and models.networks.rnn:LSTM both have the name 'lstm'"):
        plan(asked, World())
    tasks, _ = plan(SweepArguments(episodes=1, rnn=["models.networks.rnn:LSTM"], weights=weights), World())
    assert {task.rnn for task in tasks} == {"lstm"}


def test_every_severity_of_a_fault_and_no_other_kind_twice(weights):
    asked = SweepArguments(episodes=1, disturbance=["A", "camera_shift"], severity=[0.5, 1.0], weights=weights)
    asked.check()
    tasks, _ = plan(asked, World())
    assert [(t.disturbance, t.severity) for t in tasks] == [("A", None), ("camera_shift", 0.5), ("camera_shift", 1.0)]
    assert [t.key for t in tasks] == [
        f"lstm-0-recall-own-{kind}-2000000" for kind in ("A", "camera_shift-0.5", "camera_shift-1.0")
    ]
    assert tasks[1].labels()["severity"] == 0.5


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (dict(disturbance=["camera_gone"]), "no disturbance 'camera_gone': choose from none, A, B, moved, camera_gain"),
        (dict(disturbance=["camera_shift"], severity=[0.5, 1.2]), "severity 1.2 is out of range: choose from 0 to 1"),
        (dict(severity=[0.5]), "severity 0.5 says nothing to the disturbance 'none'"),
        (dict(severity=[]), "no severity given"),
    ],
)
def test_bad_faults_and_severities_are_named(changes, named):
    with pytest.raises(InputError, match=named):
        SweepArguments(**changes).check()
