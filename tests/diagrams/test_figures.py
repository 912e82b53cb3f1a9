"""The figures: what is chosen, left out and computed for them, and that they are drawn."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from diagrams import figures
from diagrams.drawing import paper_figures as plots
from diagrams.episodes import rollout as rollout_module
from diagrams.episodes.calibration import Controller
from diagrams.episodes.episode import Episode
from diagrams.episodes.pool import Job, Worker
from diagrams.episodes.record import save_record
from diagrams.episodes.sampling import SEED_BASE
from diagrams.figures import FiguresArguments, Looks
from diagrams.world.configuration import World
from models.errors import InputError
from models.files.weights import WeightsError
from models.networks.cae import ConvolutionalAutoencoder
from tests.diagrams.drawing.test_pictures import PNG, record
from tests.diagrams.sweeps.test_summary import frame
from tests.diagrams.untrained import save_untrained


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return save_untrained(tmp_path_factory.mktemp("weights"))


def is_png(path):
    return path.read_bytes().startswith(PNG)


def test_recall_losses_of_what_is_there(tmp_path, weights, capsys):
    (tmp_path / "lstm-2.safetensors").write_bytes((weights / "lstm.safetensors").read_bytes())
    (tmp_path / "lstm.safetensors").write_bytes((weights / "lstm.safetensors").read_bytes())
    losses = figures.recall_losses(tmp_path)
    assert list(losses) == ["lstm"]
    assert losses["lstm"] == pytest.approx(np.full((2, 10), 1e-9))
    printed = capsys.readouterr().out
    assert "gru has no calibrated weights" in printed
    assert "mtrnn has no calibrated weights" in printed
    plots.save_recall_loss(losses, tmp_path / "new" / "fig4.png")
    assert is_png(tmp_path / "new" / "fig4.png")


def test_subtasks_change_at_the_initial_posture_only():
    home = np.array([1, 0, 0, 1, 0, 0, 1, 0], bool)
    held = np.array([0, 0, 1, 1, 1, 0, 0, 1], bool)
    assert figures.subtasks(home, held).tolist() == [1, 1, 1, 2, 2, 2, 1, 1]
    assert figures.subtasks(np.zeros(8, bool), held).tolist() == [1] * 8


def test_principal_states_are_those_of_the_decomposition(tmp_path):
    rng = np.random.default_rng(0)
    runs = {name: record(60) for name in ("a", "b")}
    for run in runs.values():
        run.hidden_state = rng.normal(size=(60, 5)) * [5, 3, 2, 0.1, 0.1]
    found, origin, ratios = figures.principal_states(runs, World())
    states = np.concatenate([run.hidden_state for run in runs.values()])
    values = np.linalg.svd(states - states.mean(axis=0), compute_uv=False) ** 2
    assert ratios == pytest.approx(values[:3] / values.sum())
    # c_0 = 0 is where the components say it is: as far from each state as it was, but for what they leave out.
    off = np.linalg.norm(found["a"][0] - origin, axis=1)
    assert off == pytest.approx(np.linalg.norm(runs["a"].hidden_state[:, :3], axis=1), abs=0.5)
    plots.save_states(found, origin, ratios, tmp_path / "fig7.png")
    assert is_png(tmp_path / "fig7.png")


def test_sequences_are_drawn(tmp_path):
    plots.save_sequences({"none": record(), "A": record()}, tmp_path / "fig5.png")
    assert is_png(tmp_path / "fig5.png")


def with_peaks(rows, normal, disturbed):
    return rows.assign(error_peak_normal=normal, error_peak_disturbed=disturbed)


def test_gamma_curves_and_their_bounds(tmp_path):
    rows = pd.concat(
        [
            with_peaks(frame("lstm", [1, 1, 0, 0], gamma=10.0), np.nan, np.nan),
            with_peaks(frame("lstm", [1, 0, 0, 0], gamma=1000.0), [5.0, 5.0, 50.0, 5.0], [2000.0, 400.0, 400.0, 8.0]),
            with_peaks(frame("lstm", [1, 1, 1, 1], gamma=10.0, disturbance="none"), np.nan, np.nan),
            with_peaks(frame("lstm", [1, 1, 1, 1]), np.nan, np.nan),
        ]
    )
    curves, bounds = figures.gamma_curves(rows)
    assert list(curves) == ["LSTM recall, A"]  # one point alone is no curve
    assert [(p["gamma"], p["rate"]) for p in curves["LSTM recall, A"]] == [(10.0, 0.5), (1000.0, 0.25)]
    gammas, share = bounds["LSTM recall, A"]
    assert (gammas[0], gammas[-1]) == pytest.approx((10.0, 1000.0))
    # At 10: the third run is a false alarm, the fourth is not noticed; at 100 the third is fine; at 1000 the first alone is noticed.
    assert np.interp([10.0, 100.0, 1000.0], gammas, share) == pytest.approx([0.5, 0.75, 0.25])
    plots.save_gamma_curve(curves, bounds, tmp_path / "gamma.png")
    assert is_png(tmp_path / "gamma.png")
    assert figures.gamma_curves(rows[rows["gamma"].isna()]) == ({}, {})


def test_sweeps_are_read_together_and_no_episode_twice(tmp_path):
    own = frame("lstm", [1, 0])
    swept = frame("lstm", [1, 0], gamma=3.0).assign(success=None, failure=None, paper_switch_success=None)
    for name, rows in (("own", own), ("swept", swept)):
        (tmp_path / name).mkdir()
        rows.to_parquet(tmp_path / name / "episodes.parquet")
    rows = figures.read_sweeps([tmp_path / "own", tmp_path / "swept"])
    assert rows["success"].tolist() == [True, False, None, None]
    assert rows["gamma"].isna().tolist() == [True, True, False, False]
    assert rows["gamma"].dtype == float
    with pytest.raises(InputError, match="they would count twice"):
        figures.read_sweeps([tmp_path / "own", tmp_path / "own"])


def test_the_episode_in_which_all_went_well_is_shown(draws):
    arguments = FiguresArguments()
    rows = frame("lstm", [0, 0, 1, 1], disturbance="A")
    assert figures.choose("A", rows, arguments, draws).seed == 2
    with pytest.raises(InputError, match="no episode of lstm, training seed 0, disturbance B"):
        figures.choose("B", rows, arguments, draws)
    base = SEED_BASE["evaluation"] + 10_000
    assert figures.choose("none", None, FiguresArguments(seed=1), draws).seed == base
    robbed = figures.choose("B", None, FiguresArguments(seed=1), draws)
    assert robbed.seed >= base
    assert robbed.disturbance.can_moved_to is not None


def test_looking_changes_nothing(rollout, policy, monkeypatch):
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 3.0)
    episode = Episode(0, (0.555, -0.041), "left")
    policy.learn(episode)
    _, plain = rollout.run(episode)
    policy.learn(episode)
    _, looked_at, looks = figures.run(rollout, episode)
    assert plain.posture.tobytes() == looked_at.posture.tobytes()
    assert looks.tick == [0, 5, 10, 15, 20, 25]
    assert {rgb.shape for rgb in looks.rgb} == {(112, 112, 3)}


def test_pictures_stand_next_to_what_happened(tmp_path):
    class Encoder:
        def encode(self, rgb):
            return np.zeros(30)

    looks = Looks(list(range(0, 120, 5)), [np.full((112, 112, 3), n, np.uint8) for n in range(24)], [np.zeros(30)] * 24)
    columns = figures.reconstructions(record(), looks, Encoder(), ConvolutionalAutoencoder().eval())
    # Events at 0, 3.9 and 4.1 s; the two last have the same picture.
    assert [(seconds, what.count(";")) for seconds, what, _ in columns] == [(0.0, 0), (4.0, 1)]
    assert columns[1][2][0][0, 0, 0] == 8
    plots.save_reconstructions(columns, figures.PICTURES, tmp_path / "fig6.png")
    assert is_png(tmp_path / "fig6.png")


def test_all_of_it_on_untrained_networks(tmp_path, weights, monkeypatch, capsys):
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 1.5)
    assert figures.main(FiguresArguments(out=tmp_path / "out", weights=weights)) == 0
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {
        "fig4_recall_loss.png", "fig5_sequences.png", "fig6_reconstructions.png", "fig7_states.png", "figures.json",
    }  # fmt: skip
    notes = json.loads((tmp_path / "out" / "figures.json").read_text())
    assert len(notes["contribution_ratios"]) == 3
    assert set(notes["episodes"]) == {"none", "A", "B"}
    assert "its curve is left out" in capsys.readouterr().out


def test_from_records(tmp_path, weights, monkeypatch, capsys):
    """Of one that comes out again to the bit, all figures; of one that does not, those that need no pictures."""
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 1.5)
    worker, controller = Worker(World(), weights / "cae.safetensors"), Controller(weights / "lstm.safetensors")
    paths = [tmp_path / f"{kind}.npz" for kind in ("none", "B")]
    for path in paths:
        outcome, record = worker.run(Job(5, path.stem, log=path), controller)
    common = {"weights": weights, "out": tmp_path / "out"}
    assert figures.main(FiguresArguments(record=paths, **common)) == 0
    names = {path.name for path in (tmp_path / "out").glob("*.png")}
    assert names == {"fig4_recall_loss.png", "fig5_sequences.png", "fig6_reconstructions.png", "fig7_states.png"}

    record.posture[3] += 1e-6
    save_record(paths[1], record, outcome)
    assert figures.main(FiguresArguments(record=paths[1:], **(common | {"out": tmp_path / "other"}))) == 0
    assert "does not come out again" in capsys.readouterr().out
    assert not (tmp_path / "other" / "fig6_reconstructions.png").exists()

    with pytest.raises(InputError, match="second record of disturbance B"):
        figures.main(FiguresArguments(record=[paths[1], paths[1]], **common))
    outcome.weights_hash = "another"
    save_record(paths[1], record, outcome)
    with pytest.raises(InputError, match=r"B.npz is a run of other weights than lstm's"):
        figures.main(FiguresArguments(record=paths, **common))


def test_a_sweep_is_not_drawn_as_what_it_was_not(tmp_path, weights, monkeypatch):
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 1.5)
    outcome, _ = Worker(World(), weights / "cae.safetensors").run(
        Job(5, "none"), Controller(weights / "lstm.safetensors")
    )
    row = pd.DataFrame([outcome.to_dict() | {"gamma": np.nan}])
    figures.require_same(outcome, row)
    for changed in ({"weights_hash": "another"}, {"success": True}, {"alpha_max_before": 0.5}):
        with pytest.raises(InputError, match="episode 5 under disturbance none does not come out as in the sweep"):
            figures.require_same(outcome, row.assign(**changed))


@pytest.mark.parametrize(
    ("changes", "error", "named"),
    [
        ({"rnn": "rnn"}, InputError, "no rnn 'rnn'"),
        ({"rnn": "gru"}, WeightsError, "gru.safetensors"),
        ({"sweep": ["nowhere"]}, InputError, "episodes.parquet does not exist: run diagrams/sweep.py"),
        ({"sweep": ["damaged"]}, InputError, "episodes.parquet is damaged"),
        ({"out": "/dev/null/out"}, InputError, "cannot be written"),
    ],
)
def test_bad_input_is_refused(tmp_path, weights, changes, error, named, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("damaged").mkdir()
    Path("damaged/episodes.parquet").write_bytes(b"PAR1 but no more")
    paths = {
        name: value if name == "rnn" else [Path(v) for v in value] if name == "sweep" else Path(value)
        for name, value in changes.items()
    }
    with pytest.raises(error, match=named):
        figures.main(FiguresArguments(**({"weights": weights, "out": tmp_path} | paths)))
