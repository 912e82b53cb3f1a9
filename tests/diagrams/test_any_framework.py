"""A network that torch did not make is flown: its graph is put together by hand, its header written by hand."""

import json

import numpy as np
import onnx
import pytest
from mcap.reader import make_reader

from diagrams import pick_place, sweep
from diagrams.episodes.record import PICTURE_EVERY, load_record
from diagrams.world.configuration import World
from models.files.container import file_hash
from tests.diagrams.untrained import save_untrained
from tests.models import handmade

DRIFT = 0.05  # scaled units a tick, of the first joint


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A folder with an encoder and with handmade.onnx, written by the package onnx alone."""
    folder = save_untrained(tmp_path_factory.mktemp("weights"))
    posture = World().initial_posture
    header = {
        "kind": "policy", "format": 1, "name": "handmade", "lower": (posture - 1.0).tolist(),
        "upper": (posture + 1.0).tolist(), "initial_posture": posture.tolist(),
        "encoder_hash": file_hash(folder / "encoder.onnx"), "mean_errors": [1.0] * 3,
        "beta": 30.0, "gamma": 10.0,
    }  # fmt: skip
    onnx.save(handmade.policy(json.dumps(header), drift=DRIFT), folder / "handmade.onnx")
    return folder


def test_it_flies(weights, tmp_path, monkeypatch):
    """It predicts the posture it sees plus a drift of joint 1: that is the command, until the bounds clip it."""
    monkeypatch.chdir(tmp_path)
    words = [
        "--rnn",
        "handmade",
        "--weights",
        weights,
        "--disturbance",
        "none",
        "--record",
        "run.npz",
        "--mcap",
        "run.mcap",
    ]
    assert pick_place.main(pick_place.parse([*map(str, words)])) == 1  # it does not know the task
    record, outcome = load_record(tmp_path / "run.npz")
    ticks = len(record.time)
    assert record.picture_ticks.tolist() == list(range(0, ticks, PICTURE_EVERY))
    with (tmp_path / "run.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    counts = {summary.channels[i].topic: n for i, n in summary.statistics.channel_message_counts.items()}
    more = {"/events": len(record.events), "/tf": 2 * ticks}
    assert counts == {topic: ticks for topic in counts} | more  # a picture a tick
    assert len(counts) == 7
    assert (outcome["rnn"], outcome["switched"]) == ("handmade", False)
    assert record.hidden_state.shape[1] == 16
    steps = (record.desired_posture - record.posture)[:10]
    np.testing.assert_allclose(steps, np.eye(8)[0] * DRIFT + np.zeros((10, 8)), atol=1e-6)
    assert record.desired_posture[-1, 0] == pytest.approx(record.posture[0, 0] + 1.0)  # the header's upper bound


def test_a_sweep_takes_it_too(weights, tmp_path):
    words = ["--rnn", "handmade", "--weights", weights, "--out", tmp_path, "--episodes", "1", "--disturbance", "none"]
    assert sweep.main(sweep.parse([*map(str, words), "--workers", "1", "--until", "switching"])) == 0
    row = json.loads((tmp_path / "rows.jsonl").read_text().splitlines()[-1])
    assert "handmade" in json.dumps(row)
