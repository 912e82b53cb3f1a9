"""Detectors of other packages in the bench: those that cannot be trusted are named, a changed one is judged anew."""

import json
import sys

import numpy as np
import pytest

from diagrams import bench
from diagrams.episodes.calibration import make_detector
from models.errors import InputError
from models.files.detectors import StoredDetector, save_detector
from models.inference import Policy
from tests.diagrams import bench_fakes
from tests.diagrams.monitors.test_offline import offline, save
from tests.diagrams.test_bench import arguments
from tests.diagrams.untrained import save_untrained

THEIRS = '''
"""A detector of another package."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from systems.detector import CalibratedDetector


class Theirs(CalibratedDetector, LeafSystem):
    name = "theirs"
    learns_from = "network"

    def __init__(self, policy):
        LeafSystem.__init__(self)
        self.ticks = 0
        self.declare_ports(policy, criteria=1, reads=("features",))

    @staticmethod
    def fit(runs):
        return {"ONE": np.ones(1)}

    @staticmethod
    def build(policy, joints, arrays):
        return Theirs(policy)

    def calc_errors(self, context, mean_errors):
        self.ticks += 1
        return np.array([ERRORS]) / mean_errors
'''
SOUND = "1.0 + np.square(self.features.Eval(context)).sum()"


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Writes the other package's module, as its author does between two starts."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def module(errors, one="one"):
        monkeypatch.delitem(sys.modules, "other_package", raising=False)
        (tmp_path / "other_package.py").write_text(THEIRS.replace("ERRORS", errors).replace("ONE", one))

    yield module
    sys.modules.pop("other_package", None)


@pytest.mark.parametrize(
    ("errors", "words"),
    [
        ("np.nan", "'theirs' has errors that are no finite numbers: leave it out"),
        ("1.0 + self.ticks % 997", "'theirs' has other errors when the same run is replayed: keep what it remembers"),
        ("0.0", "criterion 1 has no error at all"),
    ],
)
def test_what_cannot_be_trusted_is_named(tmp_path, write, monkeypatch, errors, words):
    write(errors)
    monkeypatch.setattr(bench, "run_bench_task", bench_fakes.bench_row)
    (tmp_path / "weights").mkdir()
    weights = save_untrained(tmp_path / "weights")
    with pytest.raises(InputError, match=words):
        bench.main(arguments(weights, tmp_path / "out", detectors=["other_package:Theirs"]))
    assert not (tmp_path / "out/networks/theirs.safetensors").exists()
    file = save(tmp_path / "theirs.hdf5", 6)
    words = words.replace("'theirs'", "'other_package:Theirs'")
    with pytest.raises(InputError, match=words):
        offline("--data", file, "--state", "rest", "--detectors", "other_package:Theirs", "--out", tmp_path)


@pytest.mark.parametrize("fitted", ["None", "[1.0]", '{"one": None}', "{1: np.ones(1)}", '{"one": np.array([None])}'])
def test_a_fit_that_returns_no_arrays_is_named(tmp_path, write, monkeypatch, fitted):
    monkeypatch.setattr(bench, "run_bench_task", bench_fakes.bench_row)
    write(SOUND)
    path = tmp_path / "other_package.py"
    path.write_text(path.read_text().replace('{"one": np.ones(1)}', fitted))
    (tmp_path / "weights").mkdir()
    weights = save_untrained(tmp_path / "weights")
    with pytest.raises(InputError, match=r"Theirs\.fit returns .*: it must return arrays of numbers by name"):
        bench.main(arguments(weights, tmp_path / "out", detectors=["other_package:Theirs"]))


def test_a_build_that_returns_no_system_is_named(tmp_path, write):
    write(SOUND)
    path = tmp_path / "other_package.py"
    path.write_text(path.read_text().replace("return Theirs(policy)", "Theirs(policy)"))
    weights = save_untrained(tmp_path)
    save_detector(tmp_path / "theirs.safetensors", StoredDetector("theirs", {"one": np.ones(1)}))
    with pytest.raises(InputError, match="'theirs' cannot be built: its `build` returns None, no system of Drake"):
        make_detector("other_package:Theirs", Policy(weights / "lstm.onnx"), tmp_path)


def test_a_changed_one_is_fitted_and_run_again(tmp_path, write, monkeypatch):
    asked = []

    def row(folder, task):
        asked.append((task.stage, *(scored.label for scored in task.detectors if task.stage == "loop")))
        return bench_fakes.bench_row(folder, task)

    monkeypatch.setattr(bench, "run_bench_task", row)
    (tmp_path / "weights").mkdir()
    given = arguments(
        save_untrained(tmp_path / "weights"), tmp_path / "out", detectors=["speed", "other_package:Theirs"]
    )
    write(SOUND)
    assert bench.main(given) == 0
    mean = json.loads((tmp_path / "out/summary.json").read_text())["gammas"]["lstm"]["theirs"]["mean_errors"]
    asked.clear()
    assert bench.main(given) == 0
    assert not asked
    write(f"2.0 * ({SOUND})", "another")
    assert bench.main(given) == 0
    assert set(asked) == {("calibration",), ("off",), ("loop", "theirs")}
    twice = json.loads((tmp_path / "out/summary.json").read_text())["gammas"]["lstm"]["theirs"]["mean_errors"]
    assert twice == [pytest.approx(2.0 * mean[0])]
