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
