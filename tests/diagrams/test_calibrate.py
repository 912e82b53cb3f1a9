"""Calibration: which candidate is taken, what is written, and what a worker runs."""

from dataclasses import replace

import numpy as np
import pytest

from diagrams import calibrate
from diagrams.calibrate import CalibrateArguments, reference, threshold
from diagrams.episodes import pool as workers
from diagrams.episodes import rollout as rollout_module
from diagrams.episodes.calibration import OFF, Calibration, Controller
from diagrams.episodes.episode import Outcome
from diagrams.episodes.pool import Job, Result
from diagrams.episodes.sampling import SEED_BASE
from diagrams.world.configuration import World
from models.errors import InputError
from models.files.weights import WeightsError, load_policy
from tests.diagrams.untrained import save_untrained

OUTCOME = Outcome(
    seed=1, rnn="lstm", detector="recall", disturbance="A", can_xy=(0.5, 0.0), vacant="left", picked=True, placed=True,
    home=True, success=True, switched=True, detection_delay_s=0.2, false_switches=0, returned=True, resumed=True,
    switch_success=True, paper_switch_success=True, alpha_max_before=0.0, return_s=2.0, resume_s=1.0, failure=None, switch_failure=None,
    sim_seconds=40.0, realtime_factor=5.0,
)  # fmt: skip


def result(job, success=True, peak=20.0, reached=4000.0, seconds=40.0):
    outcome = replace(
        OUTCOME, seed=job.seed, disturbance=job.kind, success=success, failure=None if success else "stalled",
        sim_seconds=seconds,
    )  # fmt: skip
    mean = 1e-4 * np.arange(1, 12)
    return Result(job, outcome, 100 * mean, 100, peak * mean, None if job.kind == "none" else reached * mean)


def test_calibration_takes_the_best_candidate_and_the_middle_gamma(tmp_path, monkeypatch, capsys):
    folder = save_untrained(tmp_path / "weights")
    candidates = []
    for name in ("policy-2000", "policy-4000", "policy-6000"):
        candidates.append(tmp_path / f"{name}.safetensors")
        candidates[-1].write_bytes((folder / "lstm.safetensors").read_bytes())
    asked = []

    def run_jobs(world, encoder, policy, jobs, *, workers, calibration):
        asked.extend((policy.stem, job, calibration.gamma) for job in jobs)
        on = calibration.gamma != OFF
        if on:
            assert calibration.reference_errors == pytest.approx(20e-4 * np.arange(1, 12))
        # Undisturbed, 4000 and 6000 fail once; disturbed, 6000 is the better one.
        undisturbed, disturbed = {"policy-2000": (4, 0), "policy-4000": (1, 2), "policy-6000": (1, 1)}[policy.stem]
        for i, job in enumerate(jobs):
            yield result(job, success=i >= (undisturbed if job.kind == "none" else disturbed * on))

    monkeypatch.setattr(calibrate, "run_jobs", run_jobs)
    out = tmp_path / "out" / "lstm.safetensors"
    arguments = CalibrateArguments(candidates, out, folder / "cae.safetensors", episodes=6, disturbed=4)
    assert calibrate.main(arguments) == 0
    stored = load_policy(out)
    gamma = np.sqrt(1.0 * 200.0)  # all normal runs peak at 20 times the mean, the disturbed ones at 4000 times
    assert stored.mean_errors == pytest.approx(1e-4 * np.arange(1, 12))
    assert stored.reference_errors == pytest.approx(20e-4 * np.arange(1, 12))
    assert stored.beta == 30.0
    assert stored.gamma == pytest.approx(gamma)
    notes = stored.metadata["calibration"]
    assert notes["chosen"] == "policy-6000.safetensors"
    assert notes["selection"][f"{tmp_path.name}/policy-4000.safetensors"]["B"]["successes"] == 2
    assert set(notes["selection"][f"{tmp_path.name}/policy-2000.safetensors"]) == {"none"}
    assert stored.metadata["training"] == {"seed": 0}
    seeds = {job.seed for _, job, _ in asked}
    assert all(SEED_BASE["validation"] <= seed < SEED_BASE["evaluation"] for seed in seeds)
    # Only what cannot succeed without a detector is cut short; the rest is judged to its end.
    assert all((job.until == "detection") == (job.kind != "none" and g == OFF) for _, job, g in asked)
    assert sorted({g for _, job, g in asked if job.kind != "none"}) == pytest.approx([gamma, OFF])
    assert "5 of 6 tasks done" in capsys.readouterr().out


def test_reference_by_hand():
    # Logarithms 1, 3: mean 2, deviation sqrt(2); and 5, 5.
    found = reference(np.exp([[1.0, 5.0], [3.0, 5.0]]))
    assert np.log(found) == pytest.approx([2.0 + 2.0 * np.sqrt(2.0), 5.0])
    with pytest.raises(InputError, match="two finished"):
        reference(np.ones((1, 3)))


def test_threshold_by_hand():
    # Logarithms 1, 3 and 7, 11: means 2 and 9, deviations sqrt(2) and sqrt(8), so a third of the way, 7 / (3 sqrt(2)) deviations from either.
    gamma, deviations = threshold(np.exp([1.0, 3.0]), np.exp([7.0, 11.0]))
    assert np.log(gamma) == pytest.approx(2.0 + 7.0 / 3.0)
    assert deviations == pytest.approx(7.0 / (3.0 * np.sqrt(2.0)))


@pytest.mark.parametrize(
    ("normal", "disturbed", "named"),
    [([1.0], [9.0, 9.0], "two finished"), ([5.0, 6.0], [5.0, 5.5], "no larger errors")],
)
def test_no_threshold_where_nothing_tells_the_runs_apart(normal, disturbed, named):
    with pytest.raises(InputError, match=named):
        threshold(np.array(normal), np.array(disturbed))


def test_calibration_without_any_success_is_an_error(tmp_path, monkeypatch):
    folder = save_untrained(tmp_path / "weights")
    candidate = folder / "lstm.safetensors"
    monkeypatch.setattr(
        calibrate, "run_jobs", lambda *a, **k: (result(job, success=False) for job in a[3])
    )  # fmt: skip
    with pytest.raises(InputError, match="train longer"):
        calibrate.main(CalibrateArguments([candidate], tmp_path / "out", folder / "cae.safetensors"))


def test_an_error_of_a_process_is_the_program_s(tmp_path):
    candidate = save_untrained(tmp_path / "weights") / "lstm.safetensors"
    arguments = CalibrateArguments(
        [candidate], tmp_path / "out", tmp_path / "nowhere", episodes=2, disturbed=2, workers=1
    )
    with pytest.raises(WeightsError, match="nowhere: the weight file does not exist"):
        calibrate.main(arguments)
    with pytest.raises(InputError, match="number of workers 0 is too small"):
        calibrate.main(replace(arguments, workers=0))


def test_a_worker_runs_a_job_with_the_calibration_given(tmp_path, monkeypatch):
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 1.5)
    folder = save_untrained(tmp_path / "weights", calibrated=False)
    worker = workers.Worker(World(), folder / "cae.safetensors")
    controller = Controller(folder / "lstm.safetensors", calibration=Calibration((1.0,) * 11, 30.0, 1e12))
    found = workers.digest_errors(Job(5, "none"), *worker.run(Job(5, "none"), controller))
    assert worker.rollout(controller) is worker.rollout(controller)  # built once
    assert (found.job, found.ticks, found.outcome.seed) == (Job(5, "none"), 15, 5)
    assert found.squared_error_sum.shape == found.peak_normal.shape == (11,)
    assert np.all(found.peak_normal <= found.squared_error_sum)
    assert found.peak_disturbed is None
    assert not found.outcome.switched  # the detector is off
