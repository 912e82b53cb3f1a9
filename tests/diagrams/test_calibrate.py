"""The program: which candidate is taken, what is written, and what is refused before an episode runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diagrams import calibrate
from diagrams.calibrate import CalibrateArguments
from diagrams.episodes import validation
from diagrams.episodes.sampling import SEED_BASE, SEEDS_APART
from models.errors import InputError
from models.files.container import WeightsError
from models.files.policies import read_policy, write_policy
from models.files.weights import load_policy
from systems.detector import NEVER
from tests.diagrams.episode_fakes import outcome, record
from tests.diagrams.untrained import save_untrained

MEAN = 1e-4 * np.arange(1, 12)
SELECTION, CALIBRATION = (SEED_BASE["validation"] + SEEDS_APART * seed for seed in (0, 2))


@pytest.fixture
def candidates(tmp_path):
    folder = save_untrained(tmp_path / "weights")
    paths = [tmp_path / f"{name}.onnx" for name in ("policy-2000", "policy-4000", "policy-6000")]
    facts, graph = read_policy(folder / "lstm.onnx")
    for path in paths:  # files that differ
        write_policy(path, replace(facts, metadata=facts.metadata | {"name": path.stem}), graph.content)
    return paths


def arguments(paths, **changes):
    root = paths[0].parent
    given = CalibrateArguments(
        root / "out" / "lstm.onnx", paths, encoder=root / "weights" / "encoder.onnx", episodes=6, runs=30, disturbed=4,
        kept=root / "kept", workers=0,
    )  # fmt: skip
    return replace(given, **changes)


def run_episode(job):
    """Normal errors of MEAN, in one tick of 20 up to 20 times it; disturbed ones of 40 and more.

    Selecting, 4000 and 6000 fail once undisturbed, and of those 6000 is the better one disturbed. For gamma, a run in
    three fails, and has the larger errors.
    """
    on = job.controller.calibration.gamma != NEVER
    if job.seed >= CALIBRATION:
        assert not on
        index = job.seed - CALIBRATION
        peak = (10.0 + index) * 39 / 20 if job.kind == "none" else (50.0 + index) * 39 / 20
        rows = [MEAN] * 2 + [peak * MEAN] * (job.kind == "none")
        made_up = record(rows, [] if job.kind == "none" else [peak * MEAN, 9e9 * MEAN], job.kind != "none")
        return outcome(job, index % 3 > 0), made_up
    if on:  # of a finalist: its own means, and its largest score
        assert job.controller.calibration.mean_errors == pytest.approx(39 / 20 * MEAN)
        assert job.controller.calibration.gamma == pytest.approx(20 * 20 / 39)
    failing = {"policy-2000": (4, 0), "policy-4000": (1, 2), "policy-6000": (1, 1)}[job.controller.policy.stem]
    made_up = record([MEAN] * 19 + [20 * MEAN], [] if job.kind == "none" else [4000 * MEAN], job.kind != "none")
    return outcome(job, job.seed - SELECTION >= failing[job.kind != "none"]), made_up


@pytest.fixture
def asked(monkeypatch):
    """The jobs that were run."""
    jobs = []
    monkeypatch.setattr(validation, "run_episode", lambda job: (jobs.append(job), run_episode(job))[1])
    return jobs


def test_calibration_takes_the_best_candidate_and_gamma_from_other_runs(candidates, asked, capsys):
    given = arguments(candidates)
    assert calibrate.main(given) == 0
    stored = load_policy(given.out)
    assert stored.mean_errors == pytest.approx(39 / 20 * MEAN)  # of the finished runs of the selection: (19 + 20) / 20
    # Scores of 10 to 39, none left out; of 30 runs the largest.
    assert (stored.beta, stored.gamma) == (30.0, pytest.approx(39.0))
    notes = stored.metadata["calibration"]
    folder = candidates[0].parent.name
    assert notes["chosen"] == "policy-6000.onnx"
    assert notes["selection"][f"{folder}/policy-4000.onnx"]["B"]["successes"] == 4
    assert set(notes["selection"][f"{folder}/policy-2000.onnx"]) == {"none"}
    assert notes["seeds"] == {"selection and mean errors": 0, "gamma": 2}
    assert notes["scores"]["none"] == pytest.approx(np.arange(10.0, 40.0))
    assert notes["scores"]["B"] == pytest.approx(np.arange(50.0, 54.0))  # before the end of the disturbance
    assert (notes["gamma"]["rank"], notes["gamma"]["runs"]) == (30, 30)
    assert notes["gamma"]["share"] == pytest.approx(1 - 0.05 ** (1 / 30))
    # An error must be ln(9) / 30 above gamma to be noticed.
    assert notes["missed"]["A"] == {
        "n": 4, "missed": 0, "highest": pytest.approx(50 - np.log(9) / 30), "share": pytest.approx(1 - 0.05**0.25)
    }  # fmt: skip
    assert notes["undisturbed"]["successes"] == 20
    assert stored.metadata["training"] == {"seed": 0}
    said = capsys.readouterr().out
    assert "5 of 6 tasks done" in said
    assert "gamma 39.00, number 30 of the scores of 30 undisturbed runs" in said
    assert "disturbance B: 0 of 4 not noticed" in said


def test_seeds_and_ends_of_the_runs(candidates, asked):
    calibrate.main(arguments(candidates))
    selecting = [job for job in asked if job.seed < CALIBRATION]
    for_gamma = [job for job in asked if job.seed >= CALIBRATION]
    assert {job.seed for job in selecting} == set(range(SELECTION, SELECTION + 6))
    assert [sum(job.kind == kind for job in for_gamma) for kind in ("none", "A", "B")] == [30, 4, 4]
    assert {job.seed for job in for_gamma} == set(range(CALIBRATION, CALIBRATION + 30))
    assert {job.controller.policy.stem for job in for_gamma} == {"policy-6000"}
    # Only what cannot succeed without a detector is cut short; the rest is judged to its end.
    for job in asked:
        assert (job.until == "detection") == (job.kind != "none" and job.controller.calibration.gamma == NEVER)


def test_no_gamma_between_is_said_and_noted(candidates, monkeypatch, capsys):
    def weak(job):
        found, made_up = run_episode(job)
        return (found, made_up) if job.kind == "none" else (found, record([MEAN], [(20.0 + job.seed % 10) * MEAN], 1))

    monkeypatch.setattr(validation, "run_episode", weak)
    given = arguments(candidates)
    assert calibrate.main(given) == 0  # gamma is 39, the disturbed runs reach 20 to 23 by the MEAN
    assert "disturbance A: 4 of 4 not noticed" in capsys.readouterr().out
    words = load_policy(given.out).metadata["calibration"]["words"]
    assert all("no gamma keeps both bounds" in line for line in words[1:])


def test_a_kill_loses_no_run(candidates, asked, monkeypatch):
    class Killed(Exception):
        pass

    def killed(job):
        if len(asked) == 40:
            raise Killed
        asked.append(job)
        return run_episode(job)

    given = arguments(candidates)
    with monkeypatch.context() as patch:
        patch.setattr(validation, "run_episode", killed)
        with pytest.raises(Killed):
            calibrate.main(given)
    assert not given.out.exists()
    assert calibrate.main(given) == 0
    jobs = [(job.controller.policy, job.kind, job.seed, job.until) for job in asked]
    assert len(jobs) == len(set(jobs)) == 3 * 6 + 2 * 2 * 6 + 30 + 8
    first = given.out.read_bytes()
    asked.clear()
    assert calibrate.main(given) == 0
    assert not asked
    assert given.out.read_bytes() == first


def test_calibration_without_any_success_is_an_error(candidates, monkeypatch):
    monkeypatch.setattr(validation, "run_episode", lambda job: (outcome(job, False), record([MEAN])))
    with pytest.raises(InputError, match="train longer"):
        calibrate.main(arguments(candidates))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"out": Path("/dev/null/lstm.onnx")}, r"/dev/null/lstm\.onnx cannot be written"),
        ({"out": Path("/")}, r"/ cannot be written \(Is a directory\)"),
        ({"world": Path("nowhere.yaml")}, r"no world file nowhere\.yaml"),
        ({"candidates": [Path("nowhere.onnx")]}, r"nowhere\.onnx: the weight file does not exist"),
        ({"workers": -1}, "--workers -1 is too small: choose 0 or more"),
        ({"seed": 100}, "seed 100 is outside of 0 to 99"),
        ({"calibration_seed": 0}, "--seed and --calibration-seed are both 0"),
        ({"calibration_seed": 100}, "seed 100 is outside of 0 to 99"),
        ({"runs": 0}, "--runs 0 is too small"),
        ({"delta": 1.0}, "--delta 1.0 is no share"),
        ({"candidates": []}, "no candidate is given"),
    ],
)
def test_bad_input_is_refused_before_an_episode_runs(candidates, monkeypatch, changes, named):
    monkeypatch.setattr(validation, "run_episode", lambda job: pytest.fail("an episode was run"))
    with pytest.raises(InputError, match=named):
        calibrate.main(arguments(candidates, **changes))
    assert not (candidates[0].parent / "out" / "lstm.onnx").exists()  # a look leaves nothing behind


def test_the_world_of_a_file_is_run(candidates, monkeypatch, tmp_path):
    class Enough(Exception):
        pass

    def run_episode(job):
        assert job.world.timing.time_step == 0.00625
        raise Enough

    monkeypatch.setattr(validation, "run_episode", run_episode)
    (tmp_path / "world.yaml").write_text("timing: {time_step: 0.00625}\n")
    with pytest.raises(Enough):
        calibrate.main(arguments(candidates, world=tmp_path / "world.yaml"))


def test_an_error_of_a_process_is_the_program_s(candidates):
    with pytest.raises(WeightsError, match="nowhere: the weight file does not exist"):
        calibrate.main(arguments(candidates, encoder=Path("nowhere"), workers=1))


def test_help_tells_every_option(capsys):
    with pytest.raises(SystemExit, match="0"):
        calibrate.parse(["--help"])
    said = capsys.readouterr().out
    assert all(option in said for option in ("--candidates", "--out", "--runs", "--delta", "--disturbed"))
