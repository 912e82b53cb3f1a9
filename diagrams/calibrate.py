"""Selects a trained network by closed-loop rollouts on validation scenes, and calibrates its detector there.

    python diagrams/calibrate.py --candidates runs/lstm/policy-*.safetensors --out models/weights/lstm.safetensors

1. Each candidate runs undisturbed validation episodes with the detector off; the one that finishes most (then: fastest) is taken.
2. Mean errors, Eq. 5, are averages over those runs.
3. gamma: the geometric middle between the largest error ratio of normal runs and the smallest of disturbed runs, on validation episodes.
Validation seeds are no evaluation's seeds (diagrams/draws.py).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from diagrams.draws import SEED_BASE
from diagrams.scenario import ROOT, ScenarioError, World
from diagrams.workers import Calibration, Job, Result, run_jobs
from models.weights import WeightsError, load_policy, save_policy

BETA = 30.0  # the paper's
# The detector never fires: alpha stays 0.
OFF = 1e12


@dataclass
class CalibrateArguments:
    """Command line of calibrate.py."""

    candidates: list[Path]  # policy files with recall heads
    out: Path  # the calibrated copy of the best one
    encoder: Path = ROOT / "models" / "weights" / "cae.safetensors"
    episodes: int = 12  # undisturbed validation episodes a candidate
    disturbed: int = 16  # validation episodes of each of A and B
    seed: int = 0
    workers: int = 2


def main(arguments: CalibrateArguments) -> int:
    """Writes `arguments.out`."""
    from models.inference import Policy

    world = World()
    base = SEED_BASE["validation"] + 10_000 * arguments.seed
    horizon = Policy(arguments.candidates[0]).horizon
    off = Calibration((1.0,) * (horizon + 1), BETA, OFF)

    def run(policy: Path, kind: str, count: int, calibration: Calibration) -> list[Result]:
        from tqdm import tqdm

        rnn = Policy(policy).name
        jobs = [Job(base + i, kind, rnn) for i in range(count)]
        runs = run_jobs(world, arguments.encoder, policy, jobs, workers=arguments.workers, calibration=calibration)
        results = list(tqdm(runs, total=count, desc=f"{policy.stem} {kind}", unit="episode", leave=False, disable=None))
        return sorted(results, key=lambda r: r.job.seed)

    best: tuple[tuple[int, float], Path, list[Result]] | None = None
    selection = {}
    for policy in arguments.candidates:
        results = run(policy, "none", arguments.episodes, off)
        successes = sum(r.outcome.success for r in results)
        seconds = float(np.mean([r.outcome.sim_seconds for r in results]))
        failures = [r.outcome.failure for r in results if r.outcome.failure]
        print(
            f"{policy.name}: {successes} of {len(results)} tasks done, {seconds:.1f} s on average; failures: {failures or 'none'}",
            flush=True,
        )
        selection[policy.name] = {
            "successes": successes,
            "episodes": len(results),
            "mean_seconds": seconds,
            "failures": failures,
        }
        if best is None or (successes, -seconds) > best[0]:
            best = (successes, -seconds), policy, results
    assert best is not None
    _, chosen, normal = best
    done = [r for r in normal if r.outcome.success]
    if not done:
        raise ScenarioError(f"no candidate finished one of {arguments.episodes} tasks: train longer before calibrating")
    mean_errors = np.sum([r.squared_error_sum for r in done], axis=0) / sum(r.ticks for r in done)
    peaks = np.array([np.max(r.peak_normal / mean_errors) for r in done])
    print(f"{chosen.name}: normal error ratios peak at {np.median(peaks):.1f} (median), {peaks.max():.1f} (largest)")
    disturbed = [
        r for kind in ("A", "B") for r in run(chosen, kind, arguments.disturbed, off) if r.peak_disturbed is not None
    ]
    reached = {
        kind: np.array([np.max(r.peak_disturbed / mean_errors) for r in disturbed if r.job.kind == kind])
        for kind in ("A", "B")
    }
    for kind, ratios in reached.items():
        print(
            f"  disturbance {kind}: ratios reach {np.sort(ratios)[:4].round(1)} (smallest), {np.median(ratios):.0f} (median)"
        )
    smallest = float(np.quantile(np.concatenate(list(reached.values())), 0.02))
    gamma = float(np.sqrt(max(peaks.max(), 1.0) * max(smallest, peaks.max())))
    print(f"beta {BETA}, gamma {gamma:.1f}")
    stored = load_policy(chosen)
    notes = {
        "chosen": chosen.name,
        "selection": selection,
        "validation_seed": base,
        "normal_peaks": peaks.tolist(),
        "disturbed_peaks": {kind: ratios.tolist() for kind, ratios in reached.items()},
    }
    metadata = {**stored.metadata, "calibration": notes}
    save_policy(arguments.out, replace(stored, mean_errors=mean_errors, beta=BETA, gamma=gamma, metadata=metadata))
    print(f"written: {arguments.out}")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(tyro.cli(CalibrateArguments)))
    except (ScenarioError, WeightsError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
