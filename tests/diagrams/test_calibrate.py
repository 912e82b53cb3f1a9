"""The program: which candidate is taken, what is written, and what is refused before an episode runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diagrams import calibrate
from diagrams.calibrate import CalibrateArguments
from diagrams.episodes import validation
from diagrams.episodes.sampling import SEED_BASE
from models.errors import InputError
from models.files.container import WeightsError
from models.files.weights import load_policy
from systems.detector import NEVER
from tests.diagrams.episode_fakes import outcome, record
from tests.diagrams.untrained import save_untrained

MEAN = 1e-4 * np.arange(1, 12)


@pytest.fixture
def candidates(tmp_path):
    folder = save_untrained(tmp_path / "weights")
    paths = [tmp_path / f"{name}.onnx" for name in ("policy-2000", "policy-4000", "policy-6000")]
    for path in paths:
        path.write_bytes((folder / "lstm.onnx").read_bytes())
    return paths


def arguments(paths, **changes):
    out, encoder = paths[0].parent / "out" / "lstm.onnx", paths[0].parent / "weights" / "encoder.onnx"
    return replace(CalibrateArguments(paths, out, encoder=encoder, episodes=6, disturbed=4, workers=0), **changes)


def test_calibration_takes_the_best_candidate_and_the_middle_gamma(candidates, monkeypatch, capsys):
    asked = []

    def run_episode(job):
        asked.append(job)
        on = job.controller.calibration.gamma != NEVER
        if on:
            assert job.controller.calibration.reference_errors == pytest.approx(20 * MEAN)
        # Undisturbed, 4000 and 6000 fail once; disturbed, 6000 is the better one.
        which = {"policy-2000": (4, 0), "policy-4000": (1, 2), "policy-6000": (1, 1)}[job.controller.policy.stem]
        failing = which[0] if job.kind == "none" else which[1] * on
        normal = [MEAN] * 19 + [20 * MEAN]
        made_up = record(normal, [] if job.kind == "none" else [4000 * MEAN], job.kind != "none")
        return outcome(job, job.seed - SEED_BASE["validation"] >= failing), made_up

    monkeypatch.setattr(validation, "run_episode", run_episode)
    given = arguments(candidates)
    assert calibrate.main(given) == 0
    stored = load_policy(given.out)
    gamma = np.sqrt(
        1.0 * 200.0
    )  # normal runs peak at 20 times 1e-4 n, which is their reference; disturbed ones at 4000
    assert stored.mean_errors == pytest.approx(39 / 20 * MEAN)
    assert stored.reference_errors == pytest.approx(20 * MEAN)
    assert (stored.beta, stored.gamma) == (30.0, pytest.approx(gamma))
    notes = stored.metadata["calibration"]
    folder = candidates[0].parent.name
    assert notes["chosen"] == "policy-6000.onnx"
    assert notes["selection"][f"{folder}/policy-4000.onnx"]["B"]["successes"] == 2
    assert set(notes["selection"][f"{folder}/policy-2000.onnx"]) == {"none"}
    assert notes["validation_seed"] == SEED_BASE["validation"]
    assert notes["normal_peaks"] == pytest.approx([1.0] * 5)  # of those that finished
    assert notes["disturbed_peaks"]["A"] == pytest.approx([200.0] * 4)
    assert stored.metadata["training"] == {"seed": 0}
    assert all(SEED_BASE["validation"] <= job.seed < SEED_BASE["evaluation"] for job in asked)
    # Only what cannot succeed without a detector is cut short; the rest is judged to its end.
    gammas = [job.controller.calibration.gamma for job in asked]
    assert all(
        (j.until == "detection") == (j.kind != "none" and g == NEVER) for j, g in zip(asked, gammas, strict=True)
    )
    assert sorted({g for j, g in zip(asked, gammas, strict=True) if j.kind != "none"}) == pytest.approx([gamma, NEVER])
    assert "5 of 6 tasks done" in capsys.readouterr().out


def test_calibration_without_any_success_is_an_error(candidates, monkeypatch):
    monkeypatch.setattr(validation, "run_episode", lambda job: (outcome(job, False), record([MEAN])))
    with pytest.raises(InputError, match="train longer"):
        calibrate.main(arguments(candidates))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"out": Path("/dev/null/lstm.onnx")}, r"/dev/null/lstm\.onnx cannot be written"),
        ({"out": Path("/")}, r"/ cannot be written \(Is a directory\)"),
        ({"scenario": Path("nowhere.yaml")}, r"no scenario file nowhere\.yaml"),
        ({"candidates": [Path("nowhere.onnx")]}, r"nowhere\.onnx: the weight file does not exist"),
        ({"workers": -1}, "number of workers -1 is too small"),
        ({"seed": 100}, "seed 100 is outside of 0 to 99"),
    ],
)
def test_bad_input_is_refused_before_an_episode_runs(candidates, monkeypatch, changes, named):
    monkeypatch.setattr(validation, "run_episode", lambda job: pytest.fail("an episode was run"))
    with pytest.raises(InputError, match=named):
        calibrate.main(arguments(candidates, **changes))
    assert not (candidates[0].parent / "out" / "lstm.onnx").exists()  # a look leaves nothing behind


def test_the_scenario_s_world_is_run(candidates, monkeypatch, tmp_path):
    class Enough(Exception):
        pass

    def run_episode(job):
        assert job.world.timing.time_step == 0.00625
        raise Enough

    monkeypatch.setattr(validation, "run_episode", run_episode)
    (tmp_path / "world.yaml").write_text("world: {timing: {time_step: 0.00625}}\n")
    with pytest.raises(Enough):
        calibrate.main(arguments(candidates, scenario=tmp_path / "world.yaml"))


def test_an_error_of_a_process_is_the_program_s(candidates):
    with pytest.raises(WeightsError, match="nowhere: the weight file does not exist"):
        calibrate.main(arguments(candidates, encoder=Path("nowhere"), workers=1))


def test_help_tells_every_option(capsys):
    with pytest.raises(SystemExit, match="0"):
        calibrate.parse(["--help"])
    said = capsys.readouterr().out
    assert all(option in said for option in ("--candidates", "--out", "--scenario", "--encoder", "--disturbed"))
