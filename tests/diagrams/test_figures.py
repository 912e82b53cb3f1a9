"""figures.py: which figures are drawn of what is given, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from diagrams import figures
from diagrams.episodes.episode import Outcome
from diagrams.episodes.record import save_record
from diagrams.figures import FiguresArguments
from diagrams.sweeps.table import write_table
from models.errors import InputError
from models.files.container import file_hash
from tests.diagrams.recorded_run import recorded_run
from tests.diagrams.sweep_fakes import make_task, outcome_row
from tests.diagrams.untrained import save_untrained


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return save_untrained(tmp_path_factory.mktemp("weights"))


def save(path, weights, kind, record=None):
    values = dict.fromkeys(Outcome.__dataclass_fields__)
    values |= {"seed": 3, "disturbance": kind, "detector": "recall", "success": True, "switch_success": True}
    values["weights_hash"] = file_hash(weights / "lstm.onnx")
    save_record(path, record or recorded_run(), Outcome(**values))


def written(folder):
    return {path.name for path in folder.iterdir()}


def test_all_figures(tmp_path, weights, capsys):
    for kind in ("none", "A", "B"):
        save(tmp_path / "records" / f"{kind}.npz", weights, kind)
    for name, gamma in (("three", 3.0), ("ten", 10.0)):
        (tmp_path / name).mkdir()
        rows = [outcome_row(tmp_path, make_task(seed, "A", gamma=gamma)) for seed in range(4)]
        write_table(tmp_path / name, rows)
    asked = FiguresArguments(
        records=[tmp_path / "records"],
        sweep=[tmp_path / "three", tmp_path / "ten"],
        weights=weights,
        out=tmp_path / "o",
    )
    assert figures.main(asked) == 0
    assert written(tmp_path / "o") == {
        "fig4_recall_loss.png", "fig5_sequences.png", "fig6_reconstructions.png", "fig7_states.png", "gamma.png",
        "figures.json",
    }  # fmt: skip
    for path in (tmp_path / "o").glob("*.png"):
        assert np.ptp(imread(path)[..., :3]) > 0.5
    notes = json.loads((tmp_path / "o" / "figures.json").read_text())
    assert len(notes["contribution_ratios"]) == 3
    assert list(notes["episodes"]) == ["none", "A", "B"]
    assert [point["gamma"] for point in notes["gamma"]["LSTM recall, A"]] == [3.0, 10.0]
    printed = capsys.readouterr().out
    assert "gru has no calibrated weights" in printed
    assert "disturbance B: episode 3, task done" in printed


def test_without_records_and_sweeps(tmp_path, weights, capsys):
    assert figures.main(FiguresArguments(weights=weights, out=tmp_path)) == 0
    assert written(tmp_path) == {"fig4_recall_loss.png", "figures.json"}
    printed = capsys.readouterr().out
    assert "Figs. 5 to 7 are left out" in printed
    assert "its curve is left out" in printed


def test_of_a_record_without_pictures_fig_6_is_left_out(tmp_path, weights, capsys):
    record = recorded_run()
    record.picture_ticks, record.pictures = record.picture_ticks[:0], record.pictures[:0]
    save(tmp_path / "B.npz", weights, "B", record)
    assert figures.main(FiguresArguments(records=[tmp_path / "B.npz"], weights=weights, out=tmp_path / "o")) == 0
    assert written(tmp_path / "o") == {
        "fig4_recall_loss.png", "fig5_sequences.png", "fig7_states.png", "figures.json",
    }  # fmt: skip
    assert "the record of disturbance B holds no pictures" in capsys.readouterr().out


def test_options():
    asked = figures.parse(["--records", "a", "b.npz", "--sweep", "c", "--rnn", "gru", "--out", "d"])
    assert (asked.records, asked.sweep) == ([Path("a"), Path("b.npz")], [Path("c")])
    assert (asked.rnn, asked.out) == ("gru", Path("d"))


@pytest.mark.parametrize(
    ("changes", "error", "named"),
    [
        ({"rnn": "rnn"}, InputError, "no network 'rnn'"),
        ({"rnn": "gru"}, InputError, "no network 'gru'.*choose from lstm"),
        ({"sweep": [Path("nowhere")]}, InputError, "episodes.parquet does not exist: run diagrams/sweep.py"),
        ({"records": [Path("nowhere.npz")]}, InputError, "no record nowhere.npz"),
        ({"world": Path("nowhere.yaml")}, InputError, "no world file nowhere.yaml"),
        ({"out": Path("/dev/null/out")}, InputError, "cannot be written"),
    ],
)
def test_bad_input_is_refused(tmp_path, weights, changes, error, named):
    with pytest.raises(error, match=named):
        figures.main(FiguresArguments(**({"weights": weights, "out": tmp_path} | changes)))
