"""The baselines: gamma by hand, means and peaks, the trials, the files; and detectors by their names."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diagrams import baselines
from diagrams.baselines import BaselinesArguments, Trace, best_gamma, calibrate, digest_trace, past_windows
from diagrams.episodes import calibration as controllers
from diagrams.episodes import rollout as rollout_module
from diagrams.episodes.calibration import (
    OFF,
    Calibration,
    Controller,
    learned_hash,
    make_detector,
    policy_name,
    stored_calibration,
)
from diagrams.episodes.pool import Job, Worker
from diagrams.episodes.sampling import SEED_BASE
from diagrams.pick_place import parse
from diagrams.world.configuration import World
from models.errors import InputError
from models.files.baselines import StoredDetector, load_detector, save_detector
from models.files.weights import WeightsError
from models.inference import Policy
from systems.knn_detector import KnnDetector
from systems.recall_detector import RecallDetector
from systems.subspace_detector import SubspaceDetector
from tests.diagrams.test_calibrate import OUTCOME
from tests.diagrams.untrained import save_untrained


@pytest.mark.parametrize(
    ("normal", "disturbed", "gamma"),
    [
        ([1.0, 4.0], [100.0, 900.0], 20.0),  # apart: the geometric middle of the gap
        ([1.0, 4.0, 500.0], [100.0, 900.0], 20.0),  # one false alarm cannot be helped
        ([4.0, 9.0], [16.0, 1.0], 12.0),  # nor that one is not noticed
    ],
)
def test_best_gamma(normal, disturbed, gamma):
    assert best_gamma(np.array(normal), np.array(disturbed)) == pytest.approx(gamma)


def test_windows_of_a_run_are_what_the_detector_sees():
    angles = np.arange(24.0).reshape(12, 2)
    windows = past_windows(angles, np.array([-1.0, -2.0]))
    assert windows.shape == (2, 12, 10)
    assert windows[0, 0].tolist() == [0.0] + [-1.0] * 9
    assert windows[1, 11].tolist() == angles[11:1:-1, 1].tolist()


def ramp(slope, ticks=40):
    """A window of joint 1 rises by 9 slopes; joint 2 stands 1 rad off."""
    return np.column_stack([slope * np.arange(ticks), np.ones(ticks)])


def rise_and_offset(windows):
    return np.abs(windows[..., 0] - windows[..., -1]) + np.array([[0.0], [1.0]])


def test_calibration_by_hand():
    still = slice(0, 40), slice(40, 45)
    traces = [
        Trace("none", True, ramp(0.1)[10:], slice(0, 30), slice(30, 35)),
        Trace("none", False, ramp(100.0), *still),  # failed: counts for nothing
        Trace("A", False, np.vstack([ramp(0.1)[10:30], ramp(9.0)[10:]]), slice(0, 20), slice(20, 40)),
        Trace("B", True, ramp(0.1)[10:], slice(0, 30), slice(30, 35)),  # the disturbance never came
    ]
    mean, gamma, peaks = calibrate(rise_and_offset, traces, np.array([1.0, 1.0]))
    # Joint 1 of the first run, whose window begins at the initial posture of 1 rad: 0, 0.1 ... 0.9, then always 0.9.
    rise = [0.1 * min(k, 9) for k in range(30)]
    assert mean == pytest.approx([np.mean(rise), 1.0])
    assert peaks["normal"] == pytest.approx([0.9 / mean[0]] * 3)
    assert peaks["B"] == []
    assert len(peaks["A"]) == 1
    assert gamma == pytest.approx(np.sqrt(peaks["normal"][0] * peaks["A"][0]))


def test_calibration_needs_runs():
    failed = Trace("none", False, ramp(0.1), slice(0, 40), slice(40, 45))
    with pytest.raises(InputError, match="no undisturbed validation task"):
        calibrate(rise_and_offset, [failed], np.ones(2))
    done = Trace("none", True, ramp(0.1), slice(0, 40), slice(40, 45))
    with pytest.raises(InputError, match="no disturbance came"):
        calibrate(rise_and_offset, [done], np.ones(2))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Untrained networks, and baselines fitted to an arm that waves a little."""
    return save_untrained(tmp_path_factory.mktemp("weights"))


def waving(rng, ticks=60):
    initial = World().initial_posture[:7]
    return (
        initial
        + 0.1 * np.sin(0.1 * np.arange(ticks)[:, None] * rng.uniform(0.5, 1.5, 7))
        + 0.001 * rng.normal(size=(ticks, 7))
    )


@pytest.fixture(scope="module")
def fitted(folder):
    """The program, on made-up episodes: 20 ticks after the onset the arm jumps; the larger gamma switches right more often."""
    asked = []

    def run_jobs(world, encoder, policy, jobs, *, workers, calibration, detector, digest):
        asked.append((detector, calibration, jobs))
        for job in reversed(jobs):
            rng = np.random.default_rng(job.seed)
            if digest is baselines.digest_outcome:
                yield job, replace(OUTCOME, switch_success=calibration.gamma > 40 * (job.seed % 2))
            else:
                angles = waving(rng)
                if job.kind != "none":
                    angles[40:] += 0.3
                onset = 60 if job.kind == "none" else 40
                yield job, Trace(job.kind, True, angles, slice(0, onset), slice(onset, 60))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(baselines, "run_jobs", run_jobs)
        arguments = BaselinesArguments(
            [folder / "lstm.safetensors"], encoder=folder / "cae.safetensors", fit_episodes=5, episodes=4, disturbed=3,
            trials=2, factors=[1.0, 1e-3, 1e3], betas=[30.0, 10.0],
        )  # fmt: skip
        assert baselines.main(arguments) == 0
        asked_once = list(asked)
        # Again: what is there is kept, and never written over by other trials; another network is added to the same fit.
        assert baselines.main(arguments) == 0
        with pytest.raises(InputError, match=r"knn.safetensors was made with other disturbed \(3\)"):
            baselines.main(replace(arguments, method=["knn"], disturbed=2))
        assert asked == asked_once
        save_untrained(folder / "other", gain=0.2)
        (folder / "other" / "lstm.safetensors").rename(folder / "lstm-1.safetensors")
        policies = [folder / "lstm.safetensors", folder / "lstm-1.safetensors"]
        assert baselines.main(replace(arguments, policies=policies)) == 0
        assert len(asked) == len(asked_once) + 1 + 2 * 4
    return asked_once


def test_files_hold_what_was_chosen(folder, fitted):
    policy = Policy(folder / "lstm.safetensors")
    for method in ("knn", "subspace"):
        stored = load_detector(folder / f"{method}.safetensors", method)
        notes = stored.metadata[policy.hash]
        successes = [trial["successes"] for trial in notes["trials"]]
        assert [(trial["beta"], len(successes)) for trial in notes["trials"][2:]] == [(30.0, 4), (10.0, 4)]
        assert notes["trials"][3]["gamma"] == notes["trials"][int(np.argmax(successes[:3]))]["gamma"]
        chosen = stored_calibration(method, policy, folder)
        assert chosen.gamma == notes["trials"][int(np.argmax(successes))]["gamma"]
        assert (chosen.beta, len(chosen.reference_errors)) == (30.0, 7)
        assert min(notes["peaks"]["A"]) > max(notes["peaks"]["normal"])
    assert sum(map(len, load_detector(folder / "knn.safetensors", "knn").runs)) == 5 * 60


def test_calibrations_of_other_networks_leave_the_hash_as_it_is(folder, fitted, tmp_path):
    policy = Policy(folder / "lstm.safetensors")
    stored = load_detector(folder / "knn.safetensors", "knn")
    assert len(stored.calibrations) == 2
    alone = replace(stored, calibrations={policy.hash: stored.calibrations[policy.hash]})
    save_detector(tmp_path / "knn.safetensors", alone)
    assert learned_hash(tmp_path, "knn", policy.hash) == learned_hash(folder, "knn", policy.hash)
    save_detector(tmp_path / "knn.safetensors", replace(alone, runs=[run + 0.01 for run in alone.runs]))
    assert learned_hash(tmp_path, "knn", policy.hash) != learned_hash(folder, "knn", policy.hash)


def test_nothing_is_tuned_on_evaluation_episodes(fitted):
    seeds = {job.seed for _, _, jobs in fitted for job in jobs}
    evaluation = range(SEED_BASE["evaluation"], SEED_BASE["evaluation"] + 1_000_000)
    assert not seeds & set(evaluation)
    fits, traces, *trials = fitted
    assert {job.seed // 1_000_000 for job in fits[2]} == {3}
    assert {job.seed // 1_000_000 for job in traces[2]} == {1}
    assert fits[1].gamma == traces[1].gamma == OFF
    assert [name for name, _, _ in trials] == ["knn"] * 4 + ["subspace"] * 4


def test_detectors_by_name(folder, fitted):
    policy = Policy(folder / "lstm.safetensors")
    for name, cls in (("knn", KnnDetector), ("subspace", SubspaceDetector)):
        detector, _ = make_detector(name, policy, folder)
        assert isinstance(detector, cls)
        assert detector.GetOutputPort("errors").size() == 7
    assert isinstance(make_detector("recall", policy, folder)[0], RecallDetector)
    with pytest.raises(InputError, match="no detector 'svm'"):
        make_detector("svm", policy, folder)


@pytest.mark.parametrize("detector", ["knn", "subspace"])
def test_baseline_runs_in_the_loop_and_sees_what_the_calibration_sees(folder, fitted, monkeypatch, detector):
    """The untrained network leads the arm astray; the errors of the run are those of its windows afterwards."""
    monkeypatch.setattr(rollout_module, "TIME_LIMIT", 2.0)
    ones = Calibration((1.0,) * 7, 30.0, 1e12)
    controller = Controller(folder / "lstm.safetensors", detector, ones)
    job = Job(5, "none")
    outcome, record = Worker(World(), folder / "cae.safetensors").run(job, controller)
    assert (outcome.detector, outcome.switched) == (detector, False)
    _, trace = digest_trace(job, outcome, record)
    policy = Policy(controller.policy)
    anomaly = make_detector(detector, policy, folder, ones)[0].anomaly
    afterwards = anomaly(past_windows(trace.angles, policy.initial_posture[:7])).T
    assert record.errors.shape == (20, 7)
    assert record.errors == pytest.approx(afterwards, rel=1e-6, abs=1e-9)


def test_what_is_missing_is_said(folder, tmp_path, fitted, monkeypatch):
    policy = Policy(folder / "lstm.safetensors")
    with pytest.raises(WeightsError, match=r"knn.safetensors: the weight file does not exist"):
        make_detector("knn", policy, tmp_path)
    save_detector(tmp_path / "knn.safetensors", StoredDetector("knn", runs=[np.zeros((20, 7))]))
    with pytest.raises(WeightsError, match="no calibration for the policy"):
        make_detector("knn", policy, tmp_path)

    def absent(*arguments):
        raise ModuleNotFoundError("No module named 'sklearn'", name="sklearn")

    monkeypatch.setattr("systems.knn_detector.KnnDetector.build", absent)
    with pytest.raises(InputError, match=r"knn needs sklearn: pip install"):
        make_detector("knn", policy, folder)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"method": ["svm"]}, "no method 'svm'"),
        ({"factors": []}, "need one value"),
        ({"factors": [float("nan")]}, "factor nan is out of range"),
        ({"betas": [0.0]}, "beta 0.0 is out of range"),
        ({"policies": ["a/lstm.safetensors", "b/lstm.safetensors"]}, "several folders"),
        ({"data": "nowhere.h5"}, "nowhere.h5: the data set does not exist"),
    ],
)
def test_bad_input_is_refused(folder, changes, named):
    arguments = BaselinesArguments([folder / "lstm.safetensors"])
    for name, value in changes.items():
        setattr(arguments, name, Path(value) if name == "data" else value)
    arguments.policies = [Path(path) for path in arguments.policies]
    with pytest.raises(InputError, match=named):
        baselines.main(arguments)


def test_names():
    assert [policy_name("gru", seed) for seed in (0, 1)] == ["gru.safetensors", "gru-1.safetensors"]
    assert parse(["--detector", "knn"]).detector == "knn"
    with pytest.raises(InputError, match="no detector 'svm'"):
        parse(["--detector", "svm"])
    assert list(controllers.DETECTORS) == ["recall", "knn", "subspace"]
