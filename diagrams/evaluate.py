"""Evaluates the shipped networks on evaluation episodes: the figures of the README.

python diagrams/evaluate.py --episodes 40 --disturbance none A B --out outputs/evaluation.json
"""

from __future__ import annotations

import collections
import json
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tyro

from diagrams.draws import episode_seeds
from diagrams.scenario import DISTURBANCES, RNNS, ROOT, ScenarioError, World
from diagrams.workers import Calibration, Job, Result, run_jobs
from models.weights import WeightsError

Z95 = 1.959964


@dataclass
class EvaluateArguments:
    """Command line of evaluate.py."""

    episodes: int = 40  # a disturbance
    seed: int = 0
    rnn: str = "lstm"
    disturbance: list[str] = field(default_factory=lambda: list(DISTURBANCES))
    gamma: float | None = None  # instead of the calibrated one (3 is the paper's)
    workers: int = 2
    weights: Path = ROOT / "models" / "weights"
    out: Path = Path("outputs/evaluation.json")


def wilson(successes: int, n: int) -> tuple[float, float]:
    """95 % Wilson score interval of a rate."""
    if n == 0:
        return 0.0, 1.0
    rate, z2 = successes / n, Z95**2
    centre = (rate + z2 / (2 * n)) / (1 + z2 / n)
    half = Z95 * math.sqrt(rate * (1 - rate) / n + z2 / (4 * n * n)) / (1 + z2 / n)
    return max(0.0, centre - half), min(1.0, centre + half)


def _rate(flags: list[bool]) -> dict:
    low, high = wilson(sum(flags), len(flags))
    return {"successes": sum(flags), "n": len(flags), "rate": sum(flags) / len(flags), "interval": [low, high]}


def summarize(results: list[Result]) -> dict:
    """Rates with their intervals, delays and failure kinds of one cell."""
    outcomes = [r.outcome for r in results]

    def spread(name: str) -> dict | None:
        values = [getattr(o, name) for o in outcomes if getattr(o, name) is not None]
        return {"median": float(np.median(values)), "p95": float(np.quantile(values, 0.95))} if values else None

    return {
        "task": _rate([o.success for o in outcomes]),
        "switching": _rate([o.switch_success for o in outcomes]),
        "failures": collections.Counter(o.failure for o in outcomes if o.failure),
        "switch_failures": collections.Counter(o.switch_failure for o in outcomes if o.switch_failure),
        "detection_delay_s": spread("detection_delay_s"),
        "return_s": spread("return_s"),
        "resume_s": spread("resume_s"),
        "sim_seconds": spread("sim_seconds"),
        "realtime_factor": spread("realtime_factor"),
    }


def main(arguments: EvaluateArguments) -> int:
    """Runs all episodes, prints a table, writes the JSON after each cell."""
    from tqdm import tqdm

    from models.inference import Policy

    for kind in arguments.disturbance:
        if kind not in DISTURBANCES:
            raise ScenarioError(f"there is no disturbance '{kind}': choose from {', '.join(DISTURBANCES)}")
    if arguments.rnn not in RNNS:
        raise ScenarioError(f"there is no rnn '{arguments.rnn}': choose one of {', '.join(RNNS)}")
    policy_path = arguments.weights / f"{arguments.rnn}.safetensors"
    policy = Policy(policy_path)
    calibration = None
    if arguments.gamma is not None and policy.mean_errors is not None and policy.beta is not None:
        calibration = Calibration(tuple(policy.mean_errors), policy.beta, arguments.gamma)
    seeds = episode_seeds("evaluation", arguments.seed, arguments.episodes)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    report: dict = {
        "seed": arguments.seed,
        "rnn": arguments.rnn,
        "weights_hash": policy.hash,
        "cells": {},
        "episodes": [],
    }
    for kind in arguments.disturbance:
        jobs = [Job(seed, kind, arguments.rnn) for seed in seeds]
        runs = run_jobs(
            World(),
            arguments.weights / "cae.safetensors",
            policy_path,
            jobs,
            workers=arguments.workers,
            calibration=calibration,
        )
        results = sorted(tqdm(runs, total=len(jobs), desc=kind, unit="episode", disable=None), key=lambda r: r.job.seed)
        cell = report["cells"][kind] = summarize(results)
        report["episodes"] += [r.outcome.to_dict() for r in results]
        arguments.out.write_text(json.dumps(report, indent=1) + "\n")
        for name in ("task", "switching"):
            rate = cell[name]
            low, high = rate["interval"]
            print(
                f"{kind:5s} {name:10s} {rate['successes']:3d} of {rate['n']:3d}  {100 * rate['rate']:5.1f} %  "
                f"[{100 * low:.1f}, {100 * high:.1f}]  failures: {dict(cell['failures' if name == 'task' else 'switch_failures']) or 'none'}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(tyro.cli(EvaluateArguments)))
    except (ScenarioError, WeightsError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
