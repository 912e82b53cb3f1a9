"""Tapes: a detector that is replayed on one gives the errors that it has in the loop, to the bit."""

import functools

import numpy as np
import pytest
import torch

from diagrams.episodes.calibration import Controller, detector_file, make_detector, never_fires
from diagrams.episodes.pool import Pool
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.runner import Job, run_episode
from diagrams.episodes.sampling import episode_seeds
from diagrams.monitors import fitting
from diagrams.monitors.fitting import Tapes, calibrate, fit
from diagrams.monitors.tapes import TapedRun, replay, run_taped, taped
from models.data.runs import Tape, of_policy, rows_of
from models.errors import InputError
from models.files.container import file_hash
from models.files.detectors import StoredDetector, save_detector
from models.inference import Policy
from systems import distillation_detector
from systems.detectors import DETECTORS
from tests.diagrams import untrained
from tests.diagrams.episode_fakes import outcome
from tests.diagrams.untrained import save_untrained

TICKS = 15


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(Rollout, "run", functools.partialmethod(Rollout.run, time_limit=0.1 * TICKS))
    monkeypatch.setattr(distillation_detector, "UPDATES", 5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two networks of a kind, of two seeds."""
    folder = save_untrained(tmp_path_factory.mktemp("weights"))
    (folder / "other").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        seeded = torch.manual_seed
        patch.setattr(torch, "manual_seed", lambda _: seeded(1))
        content = untrained._untrained_policy.__wrapped__(True, file_hash(folder / "encoder.onnx"), 20.0)
    (folder / "other" / "lstm.onnx").write_bytes(content)
    return folder


@pytest.fixture(scope="module")
def policy(folder):
    return Policy(folder / "lstm.onnx")


@pytest.fixture(scope="module")
def run(world, folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Rollout, "run", functools.partialmethod(Rollout.run, time_limit=0.1 * TICKS))
        return run_taped(Job(world, folder / "encoder.onnx", Controller(folder / "lstm.onnx", "never"), 5))


def learned(name, folder, policy, tape):
    source = DETECTORS[name].learns_from
    if source == "policies":
        return DETECTORS[name].fit([(folder / part / "lstm.onnx").read_bytes() for part in ("", "other")])
    return fit(name, policy, [tape]) if source == "network" else {}


@pytest.mark.parametrize(
    "name", ["recall", "innovation", "recall_innovation", "innovation_cusum", "ensemble", "rnd", "speed"]
)
def test_a_replay_is_the_loop(world, folder, policy, run, name):
    arrays = learned(name, folder, policy, run.tape)
    save_detector(detector_file(folder, name), StoredDetector(name, arrays))
    detector = make_detector(name, policy, folder)
    criteria = detector.GetOutputPort("errors").size()
    controller = Controller(folder / "lstm.onnx", name, never_fires(criteria))
    _, record = run_episode(Job(world, folder / "encoder.onnx", controller, 5))
    found = replay(detector, run.tape, policy.scaling.scale(policy.initial_posture))
    assert record.errors.shape == (TICKS, criteria)
    assert found.tobytes() == record.errors.tobytes()
    assert np.abs(found[1:]).max() > 0.0


def test_a_tape_says_what_was_seen_and_predicted(world, policy, run):
    tape = run.tape
    assert (run.onset, run.end, len(tape.posture)) == (None, TICKS, TICKS)
    home = policy.scaling.scale(policy.initial_posture)
    assert tape.posture[0] == pytest.approx(home, abs=1e-2)
    assert tape.recalled_postures[0] == pytest.approx(np.tile(home, (policy.horizon + 1, 1)))
    assert not tape.hidden_state[0].any()
    assert not tape.predicted_features[0].any()
    # What the network makes of the first row is the second one.
    y, state, recalled = policy.step(np.concatenate((tape.posture[0], tape.features[0])), tape.hidden_state[0])
    assert np.array_equal(tape.hidden_state[1], state)
    assert np.array_equal(tape.predicted_features[1], np.clip(y[8:], -1.0, 1.0))
    assert np.array_equal(tape.recalled_postures[1], np.vstack((np.clip(y[:8], -1.0, 1.0), recalled)))
    assert rows_of([tape, tape], "hidden_state", "features").shape == (2 * TICKS, policy.state_size + 30)


def made_up(job, **changes):
    """Four ticks of an error of 1 in the feature innovation, twice that in the last, for seeds that are even thrice."""
    largest = 3.0 if job.seed % 2 == 0 else 2.0
    features = np.sqrt([[0.0], [1.0], [1.0], [largest if job.kind == "none" else 50.0]]) * np.ones(30)
    zeros = np.zeros((4, 8)), np.zeros((4, 11, 8)), np.zeros((4, 500))
    predicted = np.full((4, 30), 1e-9)
    tape = Tape(*zeros, predicted + features, predicted, np.zeros(4))
    onset = None if job.kind == "none" else 3
    return TapedRun(outcome(job, job.seed != changes.get("failed")), tape, onset, 4)


@pytest.fixture
def faked(monkeypatch):
    def run(pool, world, encoder, controller, seed, counts):
        assert controller.detector == "never"
        seeds = episode_seeds("validation", seed, max(counts.values()))
        return {k: [made_up(Job(None, None, None, s, k)) for s in seeds[:count]] for k, count in counts.items()}

    monkeypatch.setattr(fitting, "taped", run)


def tapes(world, folder, policy, runs=4, **counts):
    calibration = 2, {"none": 9, "A": 3, "B": 3} | counts
    path = folder / "lstm.onnx"
    return Tapes.run(Pool(0), world, folder, path, policy, fit=(3, runs), calibration=calibration)


def test_conformal_by_hand(world, folder, policy, faked, capsys):
    found = tapes(world, folder, policy)
    assert (len(found.fit), len(found.held_out), len(found.undisturbed)) == (3, 1, 9)
    build = functools.partial(DETECTORS["innovation_features"].build, policy, 7, {})
    calibration, notes = calibrate(found, build, delta=0.01)
    mean = (0.0 + 1.0 + 1.0 + 2.0) / 4  # of the last of the fit's runs, whose seed is odd
    assert calibration == {"mean_errors": [pytest.approx(mean)], "beta": 30.0, "gamma": pytest.approx(3.0 / mean)}
    assert notes["scores"]["none"] == pytest.approx([2.0] * 4 + [3.0] * 5)
    assert notes["scores"]["A"] == pytest.approx([50.0] * 3)
    assert (notes["missed"]["A"]["missed"], notes["gamma"]["rank"]) == (0, 9)
    assert "gamma 3.00, number 9 of the scores of 9 undisturbed runs" in capsys.readouterr().out
    calibration, _ = calibrate(found, build, delta=0.85)  # of 9 runs, at most so much with 95 % confidence
    assert calibration["gamma"] == pytest.approx(2.0)


def test_a_criterion_without_errors_is_refused(world, folder, policy, faked):
    build = functools.partial(DETECTORS["speed"].build, policy, 7, {})
    found = tapes(world, folder, policy)
    still = [Tape(**vars(tape) | {"posture": np.tile(policy.scaling.scale(policy.initial_posture), (4, 1))})
             for tape in found.held_out]  # fmt: skip
    with pytest.raises(InputError, match="criterion 1 has no error at all on normal runs"):
        calibrate(Tapes(policy, found.fit, still, found.undisturbed, {}), build, 0.01)


def test_what_is_fitted_is_kept_apart_for_each_network(policy, run):
    arrays = fit("rnd", policy, [run.tape])
    assert all(name.startswith(f"{policy.hash}/") for name in arrays)
    both = arrays | {"other/mean": np.zeros(3), "shared": np.ones(2)}
    own = of_policy(policy.hash, both)
    assert "shared" in own
    assert {"mean", "spread", "target.0.weights"} < set(own)
    assert len(own) == len(arrays) + 1


def test_runs_come_by_kind_in_the_order_of_their_seeds(world, folder, monkeypatch):
    monkeypatch.setattr("diagrams.monitors.tapes.run_taped", lambda job: job)

    class Backwards:
        def run(self, function, jobs):
            yield from ((job, function(job)) for job in reversed(jobs))

    found = taped(Backwards(), world, folder, Controller(folder / "lstm.onnx", "never"), 3, {"none": 3, "A": 2})
    first = episode_seeds("validation", 3, 1)[0]
    assert [job.seed for job in found["none"]] == [first, first + 1, first + 2]
    assert [(job.kind, job.until) for job in found["A"]] == [("A", "detection")] * 2
