"""Selects a trained network by closed-loop rollouts on validation scenes, and calibrates its detector there.

    python diagrams/calibrate.py --candidates runs/lstm/policy-*.safetensors --out models/weights/lstm.safetensors

1. Each candidate runs undisturbed validation episodes with the detector off; those that finish most go on.
2. The recall of each n is referred to an error that few of those runs reach (see reference): what lies farther back is recalled worse at times.
3. gamma, times that: as many standard deviations above the peaks of normal runs as below those of disturbed ones (see threshold).
4. If several go on, the one that finishes most disturbed validation episodes with its calibration (then: fastest undisturbed) is taken.
Validation seeds are no evaluation's seeds (diagrams/episodes/sampling.py).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from diagrams.episodes.calibration import Calibration, never_fires
from diagrams.episodes.pool import Job, Result, run_jobs
from diagrams.episodes.sampling import episode_seeds
from diagrams.episodes.switching import Until
from diagrams.world.configuration import World
from diagrams.world.names import WEIGHTS
from models.errors import InputError
from models.files.weights import WeightsError, load_policy, save_policy

BETA = 30.0  # the paper's


@dataclass
class CalibrateArguments:
    """Command line of calibrate.py."""

    candidates: list[Path]  # policy files with recall heads
    out: Path  # the calibrated copy of the best one
    encoder: Path = WEIGHTS / "cae.safetensors"
    episodes: int = 20  # undisturbed validation episodes a candidate
    disturbed: int = 24  # validation episodes of each of A and B
    seed: int = 0
    workers: int = 2


@dataclass
class Calibrated:
    """A candidate with its calibration; error ratios are l_n / reference error, the largest over n and ticks of a run."""

    mean_errors: np.ndarray  # (N + 1,) of the runs that ended in success, scaled units squared
    reference_errors: np.ndarray  # (N + 1,) scaled units squared
    gamma: float
    normal_peaks: np.ndarray  # of the undisturbed runs that ended in success
    disturbed_peaks: dict[str, np.ndarray]  # by kind


def threshold(normal: np.ndarray, disturbed: np.ndarray) -> tuple[float, float]:
    """gamma between peaks of error ratios (R,), (D,), equally many standard deviations of their logarithms from either mean; and how many.

    Not the middle of the gap: the extremes of some tens of runs say little about the next hundred. Raises InputError with fewer than two
    of either, or where the disturbed ones are no larger.
    """
    if min(len(normal), len(disturbed)) < 2:
        raise InputError(
            "gamma needs two finished undisturbed and two disturbed episodes at least: raise their numbers"
        )
    low, high = np.log(normal), np.log(disturbed)
    spread = low.std(ddof=1) + high.std(ddof=1)
    if high.mean() <= low.mean():
        raise InputError(
            "disturbed runs have no larger errors than normal ones: the recall tells nothing, train its heads longer"
        )
    deviations = (high.mean() - low.mean()) / spread if spread > 0.0 else np.inf
    share = low.std(ddof=1) / spread if spread > 0.0 else 0.5
    return float(np.exp(low.mean() + share * (high.mean() - low.mean()))), float(deviations)


def reference(peaks: np.ndarray) -> np.ndarray:
    """(N + 1,) what a run's largest l_n exceeds in 2 of 100 runs, by the logarithms of `peaks` (R, N + 1): mean + 2 standard deviations.

    The paper refers l_n to its mean on normal runs. But far back the recall is poor for a few ticks of some runs: one gamma for all n must lie
    above those, and misses stops that a small n tells. Raises InputError for fewer than two runs.
    """
    if len(peaks) < 2:
        raise InputError("reference errors need two finished undisturbed episodes at least: raise their number")
    logs = np.log(peaks)
    return np.exp(logs.mean(axis=0) + 2.0 * logs.std(axis=0, ddof=1))


class Calibrator:
    """Runs validation episodes of candidates."""

    def __init__(self, arguments: CalibrateArguments):
        self.arguments, self.world = arguments, World()
        self._seeds = episode_seeds("validation", arguments.seed, max(arguments.episodes, arguments.disturbed))
        self.first_seed = self._seeds[0]

    def run(
        self, policy: Path, kind: str, calibration: Calibration | None = None, until: Until = "task"
    ) -> list[Result]:
        """Episodes of one kind in the order of their seeds; without a calibration the detector is off."""
        from tqdm import tqdm

        from models.inference import Policy

        network = Policy(policy)
        count = self.arguments.episodes if kind == "none" else self.arguments.disturbed
        jobs = [Job(seed, kind, network.name, until) for seed in self._seeds[:count]]
        calibration = calibration or never_fires(network.horizon + 1)
        runs = run_jobs(
            self.world, self.arguments.encoder, policy, jobs, workers=self.arguments.workers, calibration=calibration
        )
        results = list(tqdm(runs, total=count, desc=f"{policy.stem} {kind}", unit="episode", leave=False, disable=None))
        return sorted(results, key=lambda r: r.job.seed)

    def calibrate(self, policy: Path, normal: list[Result]) -> Calibrated:
        """Reference errors and gamma of a candidate from its undisturbed runs and from disturbed ones, detector off."""
        done = [r for r in normal if r.outcome.success]
        mean_errors = np.sum([r.squared_error_sum for r in done], axis=0) / sum(r.ticks for r in done)
        reference_errors = reference(np.array([r.peak_normal for r in done]))
        peaks = np.array([np.max(r.peak_normal / reference_errors) for r in done])
        print(
            f"{policy.name}: normal error ratios peak at {np.median(peaks):.1f} (median), {peaks.max():.1f} (largest)"
        )
        reached = {}
        for kind in ("A", "B"):
            found = [r.peak_disturbed for r in self.run(policy, kind, until="detection")]
            ratios = reached[kind] = np.array([np.max(p / reference_errors) for p in found if p is not None])
            print(
                f"  disturbance {kind}: ratios reach {np.sort(ratios)[:4].round(1)} (smallest), {np.median(ratios):.0f} (median)"
            )
        # The kind that is harder to notice decides.
        gamma, deviations = min((threshold(peaks, ratios) for ratios in reached.values()), key=lambda found: found[1])
        print(f"  beta {BETA}, gamma {gamma:.1f}: {deviations:.1f} standard deviations from either")
        return Calibrated(mean_errors, reference_errors, gamma, peaks, reached)


def main(arguments: CalibrateArguments) -> int:
    """Writes `arguments.out`."""
    calibrator = Calibrator(arguments)
    selection: dict[Path, dict] = {}
    undisturbed = {}
    for policy in arguments.candidates:
        undisturbed[policy] = calibrator.run(policy, "none")
        selection[policy] = {"none": _tally(policy, "none", undisturbed[policy])}
    most = max(entry["none"]["successes"] for entry in selection.values())
    if not most:
        raise InputError(f"no candidate finished one of {arguments.episodes} tasks: train longer before calibrating")
    best: tuple[tuple[int, float], Path, Calibrated] | None = None
    finalists = [policy for policy in undisturbed if selection[policy]["none"]["successes"] == most]
    for policy in finalists:
        entry = selection[policy]
        calibrated = calibrator.calibrate(policy, undisturbed[policy])
        recoveries = 0
        if len(finalists) > 1:
            calibration = Calibration(tuple(calibrated.reference_errors), BETA, calibrated.gamma)
            for kind in ("A", "B"):
                entry[kind] = _tally(policy, kind, calibrator.run(policy, kind, calibration))
                recoveries += entry[kind]["successes"]
        score = recoveries, -entry["none"]["mean_seconds"]
        if best is None or score > best[0]:
            best = score, policy, calibrated
    assert best is not None
    _, chosen, calibrated = best
    stored = load_policy(chosen)
    notes = {
        "chosen": chosen.name,
        "selection": {f"{policy.parent.name}/{policy.name}": entry for policy, entry in selection.items()},
        "validation_seed": calibrator.first_seed,
        "normal_peaks": calibrated.normal_peaks.tolist(),
        "disturbed_peaks": {kind: ratios.tolist() for kind, ratios in calibrated.disturbed_peaks.items()},
    }
    metadata = {**stored.metadata, "calibration": notes}
    save_policy(
        arguments.out,
        replace(
            stored,
            mean_errors=calibrated.mean_errors,
            reference_errors=calibrated.reference_errors,
            beta=BETA,
            gamma=calibrated.gamma,
            metadata=metadata,
        ),
    )
    print(f"{chosen.name} is taken; written: {arguments.out}")
    return 0


def _tally(policy: Path, kind: str, results: list[Result]) -> dict:
    outcomes = [r.outcome for r in results]
    tally = {
        "successes": sum(bool(o.success) for o in outcomes),
        "switching": sum(o.switch_success for o in outcomes),
        "episodes": len(outcomes),
        "mean_seconds": float(np.mean([o.sim_seconds for o in outcomes])),
        "failures": {f"seed {o.seed}": o.failure for o in outcomes if o.failure},
    }
    print(
        f"{policy.name}, {kind}: {tally['successes']} of {len(outcomes)} tasks done, {tally['mean_seconds']:.1f} s on average; "
        f"failures: {tally['failures'] or 'none'}",
        flush=True,
    )
    return tally


if __name__ == "__main__":
    try:
        sys.exit(main(tyro.cli(CalibrateArguments)))
    except (InputError, WeightsError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
