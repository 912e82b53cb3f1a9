"""Fits and calibrates the two baselines of Table II, kNN and the subspace method, for trained networks.

    python diagrams/baselines.py --policies models/weights/lstm*.safetensors --data demonstrations.h5

1. Windows of each joint from the training demonstrations in --data; without it from undisturbed runs of the networks (detector off).
2. Mean errors: over undisturbed validation episodes that were finished, detector off; the episodes that calibrate.py uses.
3. gamma: where most of the validation runs, undisturbed and disturbed, are judged right.
4. Trials in closed loop on validation episodes: that gamma times each factor with the first beta, then the best with the other betas; what
   switches right most often is taken.

Writes knn.safetensors and subspace.safetensors beside the networks, after each network; the same command goes on after a kill, and one with
more policies adds them. Exit code 2: bad input.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from diagrams.episodes.calibration import Calibration, build_detector, never_fires
from diagrams.episodes.episode import Outcome, Until
from diagrams.episodes.pool import Job, run_jobs, stretches
from diagrams.episodes.rollout import Record
from diagrams.episodes.sampling import episode_seeds
from diagrams.world.scenario import DISTURBANCES, WEIGHTS, World
from diagrams.world.station import ARM_JOINTS
from models.data.windows import WINDOW, decode_runs, encode_runs, leading_axes, posture_windows
from models.errors import InputError
from models.files.detectors import StoredDetector, load_detector, save_detector
from models.files.weights import WeightsError

METHODS = ("knn", "subspace")


@dataclass
class BaselinesArguments:
    """Command line of baselines.py."""

    policies: list[Path]  # calibrated policy files, all in one folder
    data: Path | None = None  # demonstrations of diagrams/teach.py
    method: list[str] = field(default_factory=lambda: list(METHODS))  # knn, subspace
    encoder: Path = WEIGHTS / "cae.safetensors"
    fit_episodes: int = 50  # undisturbed runs of each network to fit from, without --data
    episodes: int = 20  # undisturbed validation episodes, as many as calibrate.py runs
    disturbed: int = 24  # validation episodes of each of A and B, as many as calibrate.py runs
    trials: int = 6  # validation episodes of each of none, A and B in closed loop, for each gamma and beta
    factors: list[float] = field(default_factory=lambda: [1.0, 0.5, 0.25, 2.0])  # of gamma; the first wins a draw
    betas: list[float] = field(default_factory=lambda: [30.0, 10.0, 100.0])  # the first wins a draw
    seed: int = 0
    workers: int = 2


@dataclass(frozen=True)
class Trace:
    """What the arm did in one run: angles (ticks, 7) rad; the ticks before the onset, and from it to the end of the disturbance + 5."""

    kind: str
    success: bool | None  # None: not asked for
    angles: np.ndarray
    before: slice
    after: slice


def digest_trace(job: Job, outcome: Outcome, record: Record) -> tuple[Job, Trace]:
    """See Trace."""
    return job, Trace(job.kind, outcome.success, record.posture[:, :ARM_JOINTS], *stretches(record))


def digest_outcome(job: Job, outcome: Outcome, record: Record) -> tuple[Job, Outcome]:
    """The outcome alone."""
    return job, outcome


def past_windows(angles: np.ndarray, initial: np.ndarray) -> np.ndarray:
    """(J, ticks, w): the window that a detector sees at each tick of (ticks, J) `angles`; `initial` (J,) stands before the first."""
    return posture_windows([np.vstack([np.tile(initial, (WINDOW - 1, 1)), angles])])


def best_gamma(normal: np.ndarray, disturbed: np.ndarray) -> float:
    """The gamma with most peaks of normal runs (R,) below and of disturbed runs (D,) above it: the geometric middle of the widest such gap."""
    edges = np.unique(np.concatenate([normal, disturbed]))
    # Beyond all peaks too: a gamma that calls everything normal, or nothing.
    edges = np.concatenate([[0.5 * edges[0]], edges, [2.0 * edges[-1]]])
    middles = np.sqrt(edges[:-1] * edges[1:])
    right = np.array([np.sum(normal < gamma) + np.sum(disturbed >= gamma) for gamma in middles])
    width = np.where(right == right.max(), edges[1:] / edges[:-1], 0.0)
    return float(middles[np.argmax(width)])


def calibrate(
    anomaly: Callable[[np.ndarray], np.ndarray], traces: Sequence[Trace], initial: np.ndarray
) -> tuple[np.ndarray, float, dict[str, Any]]:
    """Mean errors (J,) and gamma from runs with the detector off, and the peaks that they come from.

    `anomaly`: see WindowDetector; `initial`: (J,) rad. Raises InputError if no undisturbed run was finished.
    """
    errors = [anomaly(past_windows(trace.angles, initial)).T for trace in traces]
    done = [e for e, trace in zip(errors, traces, strict=True) if trace.kind == "none" and trace.success]
    if not done:
        raise InputError("no undisturbed validation task was finished: calibrate a network that does its task")
    mean = np.concatenate(done).mean(axis=0)
    if np.any(mean == 0.0):
        raise InputError(f"joint {int(np.argmin(mean)) + 1} has no error at all on normal runs: fit on other runs")
    peaks: dict[str, list[float]] = {kind: [] for kind in ("normal", *DISTURBANCES[1:])}
    for e, trace in zip(errors, traces, strict=True):
        for name, ticks in (("normal", trace.before), (trace.kind, trace.after)):
            # An undisturbed run that failed may have left the learned way by itself.
            if len(e[ticks]) and not (trace.kind == "none" and not trace.success):
                peaks[name].append(float((e[ticks] / mean).max()))
    disturbed = np.array(peaks["A"] + peaks["B"])
    if not len(disturbed):
        raise InputError("no disturbance came in any validation run: raise --disturbed")
    return mean, best_gamma(np.array(peaks["normal"]), disturbed), peaks


def main(arguments: BaselinesArguments) -> int:
    """Writes a file a method beside the policies; returns the exit code."""
    from models.inference import Policy

    _check(arguments)
    policies = {path: Policy(path) for path in arguments.policies}
    notes = {"data": _content(arguments.data)} | {
        name: getattr(arguments, name) for name in ("seed", "episodes", "disturbed", "trials", "factors", "betas")
    }
    stored = {
        method: found for method in arguments.method if (found := _begun(_file(arguments, method), method, notes))
    }
    new = [method for method in arguments.method if method not in stored]
    if new:
        kept = [detector.arrays for detector in stored.values() if "angles" in detector.arrays]
        encoded = kept[0] if kept else encode_runs(_training_runs(arguments, policies))
        runs = decode_runs(encoded)
        windows = posture_windows(runs)
        print(f"{windows.shape[1]} windows of {len(runs)} runs", flush=True)
        for method in new:
            fitted = {"axes": leading_axes(windows)} if method == "subspace" else encoded
            stored[method] = StoredDetector(method, fitted, metadata=dict(notes))
            save_detector(_file(arguments, method), stored[method])  # what the trials run is what was stored
    for path, policy in policies.items():
        if all(policy.hash in detector.calibrations for detector in stored.values()):
            print(f"{path.name}: calibrated already", flush=True)
            continue
        counts = {kind: arguments.episodes if kind == "none" else arguments.disturbed for kind in DISTURBANCES}
        traces = _run(arguments, path, policy, counts, digest_trace)
        for method, detector in stored.items():
            if policy.hash in detector.calibrations:
                continue
            anomaly = build_detector(detector, policy).anomaly
            mean, gamma, peaks = calibrate(anomaly, traces, policy.initial_posture[:ARM_JOINTS])
            print(
                f"{path.name}, {method}: normal errors peak at {np.median(peaks['normal']):.1f} times their mean (median), "
                f"{max(peaks['normal']):.1f} (largest); disturbed ones at "
                + ", ".join(f"{kind} {min(peaks[kind]):.1f} (smallest)" for kind in "AB" if peaks[kind])
            )
            beta, gamma, trials = _try(arguments, path, policy, method, mean, gamma)
            print(f"{path.name}, {method}: beta {beta:g}, gamma {gamma:.1f}", flush=True)
            detector.calibrations[policy.hash] = {"mean_errors": mean.tolist(), "beta": beta, "gamma": gamma}
            detector.metadata[policy.hash] = {"policy": path.name, "peaks": peaks, "trials": trials}
            save_detector(_file(arguments, method), detector)
    print(f"written: {', '.join(str(_file(arguments, method)) for method in arguments.method)}")
    return 0


def _check(arguments: BaselinesArguments) -> None:
    for method in arguments.method:
        if method not in METHODS:
            raise InputError(f"there is no method '{method}': choose from {', '.join(METHODS)}")
    if not arguments.method or not arguments.factors or not arguments.betas:
        raise InputError("methods, factors and betas need one value at least")
    for name, values in (("factor", arguments.factors), ("beta", arguments.betas)):
        for value in values:
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(f"the {name} {value} is out of range: choose a finite one above 0")
    if len({path.parent.resolve() for path in arguments.policies}) != 1:
        raise InputError("the policies lie in several folders: put them into one, their baselines lie beside them")
    if importlib.util.find_spec("sklearn") is None:
        raise InputError("the baselines need scikit-learn: pip install -e '.[sweep]'")


def _file(arguments: BaselinesArguments, method: str) -> Path:
    return arguments.policies[0].parent / f"{method}.safetensors"


def _content(data: Path | None) -> str | None:
    """The hash of the demonstrations; raises InputError if there are none in the file."""
    if data is None:
        return None
    try:
        from models.data.demonstrations import DatasetError, read_header
    except ModuleNotFoundError as absent:
        raise InputError(f"--data needs {absent.name}: pip install -e '.[train]'") from absent
    try:
        return read_header(data).content_hash
    except DatasetError as error:
        raise InputError(str(error)) from error


def _begun(file: Path, method: str, notes: dict[str, Any]) -> StoredDetector | None:
    """What an earlier call left in `file`; raises InputError if it was calibrated in another way: it is not written over."""
    if not file.exists():
        return None
    found = load_detector(file, method)
    others = [name for name, value in notes.items() if found.metadata.get(name) != value]
    if others:
        raise InputError(
            f"{file} was made with other {', '.join(others)} ({', '.join(str(found.metadata.get(name)) for name in others)}): "
            "give the same, or delete the file to calibrate anew"
        )
    return found


def _training_runs(arguments: BaselinesArguments, policies: dict[Path, Any]) -> list[np.ndarray]:
    """(T, J) rad each."""
    if arguments.data is not None:
        from models.data.demonstrations import read_demonstrations

        return [demo.posture[:, :ARM_JOINTS] for demo in read_demonstrations(arguments.data, "train")]
    traces = [
        trace
        for path, policy in policies.items()
        for trace in _run(arguments, path, policy, {"none": arguments.fit_episodes}, digest_trace, purpose="fitting")
    ]
    runs = [trace.angles for trace in traces if trace.success]
    if not runs:
        raise InputError(
            f"none of {len(traces)} tasks was finished: fit on a network that does its task, or give --data"
        )
    return runs


def _run(
    arguments: BaselinesArguments,
    path: Path,
    policy: Any,
    counts: dict[str, int],
    digest: Callable,
    *,
    purpose: str = "validation",
    method: str = "recall",
    calibration: Calibration | None = None,
) -> list[Any]:
    """Runs so many episodes of each kind of disturbance, by default with the detector off; their digests in the order of the seeds.

    Each run ends as soon as it has shown what is asked of it.
    """
    from tqdm import tqdm

    # Without a detector: whether the undisturbed task is done, and the joints up to the disturbance's end.
    ends: dict[str, Until] = dict.fromkeys(DISTURBANCES, "switching")
    if calibration is None:
        calibration = never_fires(policy.horizon + 1)
        ends = {kind: "task" if kind == "none" else "detection" for kind in DISTURBANCES}
    seeds = episode_seeds(purpose, arguments.seed, max(counts.values()))
    jobs = [Job(seed, kind, policy.name, ends[kind]) for kind, count in counts.items() for seed in seeds[:count]]
    done = run_jobs(
        World(), arguments.encoder, path, jobs, workers=arguments.workers, calibration=calibration, detector=method,
        digest=digest,
    )  # fmt: skip
    bar = tqdm(done, total=len(jobs), desc=f"{path.stem} {method}", unit="episode", leave=False, disable=None)
    return [digested for _, digested in sorted(bar, key=lambda pair: (pair[0].seed, pair[0].kind))]


def _try(
    arguments: BaselinesArguments, path: Path, policy: Any, method: str, mean: np.ndarray, gamma: float
) -> tuple[float, float, list[dict[str, float]]]:
    """The beta and gamma with most switching successes in closed loop, and how each did."""
    trials: list[dict[str, float]] = []

    def best(candidates: list[tuple[float, float]]) -> tuple[float, float]:
        for beta, value in candidates:
            calibration = Calibration(tuple(mean.tolist()), beta, value)
            counts = dict.fromkeys(DISTURBANCES, arguments.trials)
            outcomes = _run(arguments, path, policy, counts, digest_outcome, method=method, calibration=calibration)
            successes = sum(o.switch_success for o in outcomes)
            print(f"  beta {beta:g}, gamma {value:.1f}: {successes} of {len(outcomes)} switched right", flush=True)
            trials.append({"beta": beta, "gamma": value, "successes": successes, "episodes": len(outcomes)})
        found = max(trials, key=lambda trial: trial["successes"])
        return found["beta"], found["gamma"]

    first, *others = arguments.betas
    _, gamma = best([(first, factor * gamma) for factor in arguments.factors])
    return *best([(beta, gamma) for beta in others]), trials


if __name__ == "__main__":
    try:
        sys.exit(main(tyro.cli(BaselinesArguments, description=__doc__)))
    except (InputError, WeightsError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
