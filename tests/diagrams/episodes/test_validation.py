"""Validation episodes: which are run, in which order they come back, and what is kept of a real one."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from diagrams.episodes import validation as validation_module
from diagrams.episodes.calibration import Controller, detector_file, make_detector, never_fires
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.runner import Job, run_episode
from diagrams.episodes.sampling import SEED_BASE
from diagrams.episodes.store import RowStore
from diagrams.episodes.thresholds import ValidationRun
from diagrams.episodes.validation import Validation, run_validation, tally
from models.data.windows import posture_windows
from models.files.detectors import StoredDetector, save_detector
from models.inference import Policy
from systems.detectors import DETECTORS
from tests.diagrams.episode_fakes import outcome
from tests.diagrams.untrained import save_untrained


class Backwards:
    """A pool that gives the last job first."""

    def run(self, function, jobs):
        yield from ((job, function(job)) for job in reversed(jobs))


def test_the_runs_come_by_kind_in_the_order_of_their_seeds(world, tmp_path, monkeypatch):
    controller = Controller(tmp_path / "lstm.onnx")
    validation = Validation(Backwards(), world, tmp_path / "encoder.onnx", 3)
    monkeypatch.setattr(validation_module, "run_validation", lambda job: job)
    asked = validation.run(controller, {"none": 3, "B": 2})
    assert [*asked] == ["none", "B"]
    first = SEED_BASE["validation"] + 3 * 10_000
    assert [job.seed for job in asked["none"]] == [first, first + 1, first + 2]
    assert [job.seed for job in asked["B"]] == [first, first + 1]
    assert {(job.kind, job.until) for jobs in asked.values() for job in jobs} == {("none", "task"), ("B", "detection")}
    assert {job.until for job in validation.run(controller, {"A": 2}, "switching")["A"]} == {"switching"}
    assert all(job.controller == controller and job.encoder.name == "encoder.onnx" for job in asked["none"])


class Killed(Exception):
    pass


def test_kept_runs_are_not_run_again(world, tmp_path, monkeypatch):
    """A kill after three of five loses nothing; another controller, or another end, is another run."""
    (tmp_path / "lstm.onnx").write_bytes(b"weights")
    done, most = [], 3

    def run_validation(job):
        if len(done) == most:
            raise Killed
        done.append((job.kind, job.seed))
        return ValidationRun(outcome(job), 3, np.full(2, job.seed / 3), np.full(2, 0.1), None)

    monkeypatch.setattr(validation_module, "run_validation", run_validation)
    controller = Controller(tmp_path / "lstm.onnx", calibration=never_fires(11))

    def run(controller=controller, until=None):
        with RowStore(tmp_path / "kept.jsonl", {}) as store:
            asked = Validation(Backwards(), world, tmp_path / "encoder.onnx", 3, store)
            return asked.run(controller, {"none": 3, "B": 2}, until)

    with pytest.raises(Killed):
        run()
    before, most = set(done), 99
    done.clear()
    found = run()
    assert (len(before), len(done)) == (3, 2)
    seeds = [r.outcome.seed for r in found["none"]]
    assert before | set(done) == {("none", seed) for seed in seeds} | {("B", seed) for seed in seeds[:2]}
    assert [(r.outcome.disturbance, r.total.tolist()) for r in found["B"]] == [("B", [s / 3, s / 3]) for s in seeds[:2]]

    def run_anew(**changes):
        done.clear()
        rows = [[r.row() for r in runs] for runs in run(**changes).values()]
        assert rows == [[r.row() for r in runs] for runs in found.values()]
        return len(done)

    assert run_anew() == 0
    assert run_anew(until="task") == 2  # the disturbed ones, which went on to the detection alone
    assert run_anew(controller=replace(controller, calibration=None)) == 5
    (tmp_path / "lstm.onnx").write_bytes(b"other weights")
    assert run_anew() == 5


def test_tally(capsys):
    jobs = [Job(None, None, None, seed=seed) for seed in (4, 5, 6)]
    outcomes = [outcome(job, job.seed != 5, sim_seconds=10.0 * job.seed) for job in jobs]
    found = tally("net", [ValidationRun(given, 0, None, None, None) for given in outcomes])
    assert found == {
        "successes": 2, "switching": 3, "episodes": 3, "mean_seconds": 50.0, "failures": {"seed 5": "stalled"},
    }  # fmt: skip
    assert "net: 2 of 3 tasks done, 50.0 s on average; failures: {'seed 5': 'stalled'}" in capsys.readouterr().out


def test_what_is_kept_of_a_run_with_the_detector_off(world, tmp_path, monkeypatch):
    monkeypatch.setattr(Rollout, "run", functools.partialmethod(Rollout.run, time_limit=1.5))
    folder = save_untrained(tmp_path, calibrated=False)
    job = Job(world, folder / "encoder.onnx", Controller(folder / "lstm.onnx", calibration=never_fires(11)), 5)
    _, record = run_episode(job)
    found = run_validation(job)
    assert (found.ticks, found.outcome.seed, found.after) == (15, 5, None)
    assert np.array_equal(found.before, record.errors.max(axis=0))
    assert np.array_equal(found.total, record.errors.sum(axis=0))
    assert not found.outcome.switched  # the untrained network errs a lot


@pytest.mark.parametrize("spec", ["knn", "subspace"])
def test_errors_of_a_run_are_those_of_its_windows(world, tmp_path, monkeypatch, spec):
    """The untrained network leads the arm astray; the window before the first tick is the initial posture."""
    monkeypatch.setattr(Rollout, "run", functools.partialmethod(Rollout.run, time_limit=2.0))
    folder, home = save_untrained(tmp_path), world.initial_posture[:7]
    runs = [home + 0.1 * np.sin(np.arange(40)[:, None] * rate) for rate in (0.05, 0.1)]
    save_detector(detector_file(folder, spec), StoredDetector(spec, DETECTORS[spec].fit(runs)))
    controller = Controller(folder / "lstm.onnx", spec, never_fires(7))
    job = Job(world, folder / "encoder.onnx", controller, 5)
    _, record = run_episode(job)
    windows = posture_windows([np.vstack([np.tile(home, (9, 1)), record.posture[:, :7]])])
    detector = make_detector(spec, Policy(controller.policy), folder)
    assert record.errors.shape == (20, 7)
    assert record.errors == pytest.approx(detector.anomaly(windows).T, rel=1e-6, abs=1e-9)
    assert np.array_equal(run_validation(job).before, record.errors.max(axis=0))
