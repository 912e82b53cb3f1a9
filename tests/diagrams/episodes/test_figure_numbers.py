"""The numbers of the figures, from records and weight files made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from diagrams.episodes.episode import Outcome
from diagrams.episodes.figure_numbers import (
    choose_records,
    principal_states,
    recall_losses,
    reconstructions,
    subtasks,
)
from diagrams.episodes.record import save_record
from diagrams.world.configuration import World
from models.errors import InputError
from models.files.policies import read_policy, write_policy
from tests.diagrams.recorded_run import recorded_run
from tests.diagrams.untrained import save_untrained

TAKEN = (4.4, "the can is taken from the hand and put elsewhere on the desk")


def save(path, kind="B", success=True, switched=True, taken=False, **changes):
    values = dict.fromkeys(Outcome.__dataclass_fields__)
    values |= {
        "seed": int(path.stem), "disturbance": kind, "detector": "recall", "weights_hash": "ours",
        "success": success, "switch_success": switched,
    }  # fmt: skip
    record = recorded_run()
    record.events += [TAKEN] * taken
    save_record(path, record, Outcome(**(values | changes)))


def test_recall_losses_of_what_is_there(tmp_path):
    save_untrained(tmp_path)
    (tmp_path / "lstm-2.onnx").write_bytes((tmp_path / "lstm.onnx").read_bytes())
    losses = recall_losses(tmp_path)
    assert list(losses) == ["lstm"]
    assert losses["lstm"] == pytest.approx(np.full((2, 10), 1e-9))
    save_untrained(tmp_path, calibrated=False)
    assert recall_losses(tmp_path)["lstm"].shape == (1, 10)
    facts, graph = read_policy(tmp_path / "lstm-2.onnx")
    write_policy(tmp_path / "lstm-1.onnx", replace(facts, mean_errors=np.ones(4)), graph.content)
    with pytest.raises(InputError, match=r"the files of 'lstm' in .* recall 3 and 10 ticks: put"):
        recall_losses(tmp_path)


def test_the_first_run_in_which_all_went_well_is_shown(tmp_path):
    save(tmp_path / "1.npz", success=False, taken=True)
    save(tmp_path / "2.npz")
    save(tmp_path / "3.npz", taken=True)
    save(tmp_path / "4.npz", taken=True)
    save(tmp_path / "5.npz", kind="none", success=False)
    save(tmp_path / "6.npz", kind="none")
    save(tmp_path / "7.npz", kind="A", switched=False)
    chosen = choose_records([tmp_path], "ours")
    assert [(kind, outcome["seed"]) for kind, (_, outcome) in chosen.items()] == [("none", 6), ("A", 7), ("B", 3)]
    assert TAKEN in chosen["B"][0].events
    assert choose_records([tmp_path / "1.npz", tmp_path / "2.npz"], "ours")["B"][1]["seed"] == 2


def test_runs_of_others_are_not_shown(tmp_path):
    save(tmp_path / "1.npz", weights_hash="another")
    save(tmp_path / "2.npz", detector="knn")
    with pytest.raises(InputError, match="none of 2 records is a run of these weights"):
        choose_records([tmp_path], "ours")
    save(tmp_path / "3.npz", success=False)
    assert choose_records([tmp_path], "ours")["B"][1]["seed"] == 3


def test_pictures_stand_next_to_what_happened():
    # Events at 0, 3.9 and 4.1 s: the two last have the same picture, that of tick 40.
    columns = reconstructions(
        recorded_run(),
        lambda picture: np.full(30, picture[0, 0, 0] / 100 + 0.25),
        lambda features: np.full((112, 112, 3), 100 * features[0], np.uint8),
    )
    assert [(seconds, what.count(";")) for seconds, what, _ in columns] == [(0.0, 0), (4.0, 1)]
    assert [[picture[0, 0, 0] for picture in pictures] for _, _, pictures in columns] == [[0, 25, 75], [8, 33, 75]]


def test_subtasks_change_at_the_initial_posture_only():
    home = np.array([1, 0, 0, 1, 0, 0, 1, 0], bool)
    held = np.array([0, 0, 1, 1, 1, 0, 0, 1], bool)
    assert subtasks(home, held).tolist() == [1, 1, 1, 2, 2, 2, 1, 1]
    assert subtasks(np.zeros(8, bool), held).tolist() == [1] * 8


def test_principal_states_are_those_of_the_decomposition():
    runs = {name: recorded_run(60, seed) for seed, name in enumerate("ab")}
    world = World()
    runs["b"].posture[:] = world.initial_posture
    runs["b"].posture[30:, -1] = 0.03
    runs["b"].can_poses[:, 6] = np.where(np.arange(60) < 40, 0.05, 0.15)
    found, origin, ratios = principal_states(runs, world)
    states = np.concatenate([run.hidden_state for run in runs.values()])
    values = np.linalg.svd(states - states.mean(axis=0), compute_uv=False) ** 2
    assert ratios == pytest.approx(values[:3] / values.sum())
    # c_0 = 0 is where the components say it is: as far from each state as it was, but for what they leave out.
    off = np.linalg.norm(found["a"][0] - origin, axis=1)
    assert off == pytest.approx(np.linalg.norm(runs["a"].hidden_state[:, :3], axis=1), abs=0.5)
    assert found["b"][1].tolist() == [1] * 40 + [2] * 20
    assert found["b"][2] is runs["b"].alpha
