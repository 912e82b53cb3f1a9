"""Selects a trained network by closed-loop rollouts on validation scenes, and calibrates its detector there.

    python diagrams/calibrate.py --candidates runs/lstm/policy-*.onnx --out models/weights/lstm.onnx

1. Each candidate runs undisturbed validation episodes with the detector off; those that finish most go on.
2. References and gamma come from those runs and from disturbed ones: see by_spread in diagrams/episodes/thresholds.py.
3. If several go on, the one that finishes most disturbed validation episodes with its calibration (then: fastest
   undisturbed) is taken.

Exit code 2: bad input.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from diagrams.episodes.calibration import Calibration, Controller, never_fires
from diagrams.episodes.pool import Pool
from diagrams.episodes.thresholds import by_spread
from diagrams.episodes.validation import Validation, tally
from diagrams.world.names import ENCODER, WEIGHTS
from diagrams.world.scenario import load_world
from models.command_line import require_writable, run
from models.errors import InputError

BETA = 30.0  # the paper's


@dataclass
class CalibrateArguments:
    """Command line of calibrate.py."""

    candidates: list[Path]  # policy files with recall heads
    out: Path  # the calibrated copy of the best one
    scenario: Path | None = None  # YAML file whose world the episodes run in
    encoder: Path = WEIGHTS / ENCODER  # file of the encoder
    episodes: int = 20  # undisturbed validation episodes a candidate
    disturbed: int = 24  # validation episodes of each of A and B
    seed: int = 0  # 0 to 99: which validation episodes
    workers: int = 2  # processes


def parse(arguments: list[str] | None = None) -> CalibrateArguments:
    """The command line."""
    return tyro.cli(CalibrateArguments, args=arguments, description=__doc__)


def main(arguments: CalibrateArguments) -> int:
    """Writes `arguments.out`; returns the exit code."""
    require_writable(arguments.out)
    if not arguments.candidates:
        raise InputError("no candidate is given: give --candidates one file or more")
    from models.files.policies import read_policy, write_policy
    from models.inference import Policy

    world = load_world(arguments.scenario)
    off = {path: Controller(path, calibration=never_fires(Policy(path).horizon + 1)) for path in arguments.candidates}
    counts = dict.fromkeys("AB", arguments.disturbed)
    with Pool(arguments.workers) as pool:
        validation = Validation(pool, world, arguments.encoder, arguments.seed)
        undisturbed, tallies = {}, {}
        for path, controller in off.items():
            undisturbed[path] = validation.run(controller, {"none": arguments.episodes})["none"]
            tallies[path] = {"none": tally(f"{path.name}, none", undisturbed[path])}
        most = max(entry["none"]["successes"] for entry in tallies.values())
        if not most:
            raise InputError(f"no candidate finished one of {arguments.episodes} tasks: train longer, then calibrate")
        finalists = [path for path, entry in tallies.items() if entry["none"]["successes"] == most]
        scores, found = {}, {}
        for path in finalists:
            thresholds = found[path] = by_spread(undisturbed[path], validation.run(off[path], counts))
            print(f"{path.name}, {thresholds.words()}", flush=True)
            if len(finalists) > 1:
                calibration = Calibration(tuple(thresholds.reference_errors), BETA, thresholds.gamma)
                disturbed = validation.run(Controller(path, calibration=calibration), counts, "task")
                tallies[path] |= {kind: tally(f"{path.name}, {kind}", runs) for kind, runs in disturbed.items()}
            recoveries = sum(entry["successes"] for kind, entry in tallies[path].items() if kind != "none")
            scores[path] = recoveries, -tallies[path]["none"]["mean_seconds"]
    chosen = max(finalists, key=lambda path: scores[path])
    thresholds, (facts, graph) = found[chosen], read_policy(chosen)
    notes = {
        "chosen": chosen.name,
        "selection": {f"{path.parent.name}/{path.name}": entry for path, entry in tallies.items()},
        "validation_seed": undisturbed[chosen][0].outcome.seed,
        "normal_peaks": thresholds.normal.tolist(),
        "disturbed_peaks": {kind: peaks.tolist() for kind, peaks in thresholds.disturbed.items()},
    }
    calibrated = replace(
        facts, mean_errors=thresholds.mean_errors, reference_errors=thresholds.reference_errors, beta=BETA,
        gamma=thresholds.gamma, metadata={**facts.metadata, "calibration": notes},
    )  # fmt: skip
    write_policy(arguments.out, calibrated, graph.content)
    print(f"{chosen.name} is taken; written: {arguments.out}")
    return 0


if __name__ == "__main__":
    run(main, parse)
