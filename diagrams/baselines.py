"""Fits and calibrates the detectors that learn from runs, the two baselines of Table II among them.

    python diagrams/baselines.py --policies models/weights/lstm*.onnx --data demonstrations.h5

1. Each detector learns from the training demonstrations in --data.
2. Mean errors and gamma come from validation episodes with the detector off: see by_count in
   diagrams/episodes/thresholds.py.
3. Trials in closed loop on validation episodes: that gamma times each factor with the first beta, then the best with
   the other betas; the largest share switched right is taken, in the paper's words (diagrams/episodes/switching.py),
   since these detectors let go of the arm on its way home.

Writes a file a detector (knn.safetensors, ...) beside the networks, after each network; the same command goes on after
a kill, and one with more policies adds them. Exit code 2: bad input.
"""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tyro

from diagrams.episodes.calibration import UNFITTED, Calibration, Controller, detector_file, make_detector, never_fires
from diagrams.episodes.pool import MOST_WORKERS, Pool
from diagrams.episodes.sampling import SEEDS_APART, episode_seeds
from diagrams.episodes.thresholds import best_in_loop, by_count
from diagrams.episodes.validation import Validation
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, DISTURBANCES, ENCODER, WEIGHTS
from diagrams.world.scenario import load_world
from models.checks import Range, require_numbers
from models.command_line import run
from models.errors import InputError
from systems.detectors import DETECTORS

RANGES: dict[str, Range] = {
    "episodes": (1, SEEDS_APART), "disturbed": (1, SEEDS_APART), "trials": (1, SEEDS_APART),
    "workers": (0, MOST_WORKERS), "factors": (1e-3, 1e3), "betas": (1e-3, 1e6),
}  # fmt: skip
NOTED = ("seed", "episodes", "disturbed", "trials", "factors", "betas")  # arguments that decide what is written


@dataclass
class BaselinesArguments:
    """Command line of baselines.py."""

    policies: list[Path]  # policy files, all in one folder
    data: Path  # demonstrations of diagrams/teach.py
    # names of detectors, or package.module:Class
    detector: list[str] = field(default_factory=lambda: [name for name in DETECTORS if name not in UNFITTED])
    world: Path | None = None  # YAML file of the world that the episodes run in
    encoder: Path = WEIGHTS / ENCODER  # file of the encoder
    episodes: int = 60  # undisturbed validation episodes
    disturbed: int = 60  # validation episodes of each of A and B
    trials: int = 10  # validation episodes of each of none, A and B in closed loop, for each gamma and beta
    factors: list[float] = field(default_factory=lambda: [1.0, 0.5, 0.25, 2.0])  # of gamma; the first of the best wins
    betas: list[float] = field(default_factory=lambda: [30.0, 10.0, 100.0])  # the first of the best wins
    seed: int = 0  # 0 to 99: which validation episodes
    workers: int = 2  # processes


def parse(arguments: list[str] | None = None) -> BaselinesArguments:
    """The command line."""
    return tyro.cli(BaselinesArguments, args=arguments, description=__doc__)


def main(arguments: BaselinesArguments) -> int:
    """Writes a file a detector beside the policies; returns the exit code."""
    _check(arguments)
    from models.data.demonstrations import read_demonstrations, read_header
    from models.files.detectors import StoredDetector, save_detector
    from models.inference import Policy

    world = load_world(arguments.world)
    policies = {path: Policy(path) for path in arguments.policies}
    files = {spec: detector_file(arguments.policies[0].parent, spec) for spec in arguments.detector}
    notes = {"data": read_header(arguments.data).content_hash} | {name: getattr(arguments, name) for name in NOTED}
    if world != World():
        notes["world"] = dataclasses.asdict(world)
    stored = {spec: found for spec, file in files.items() if (found := _begun(file, spec, notes))}
    if len(stored) < len(files):
        runs = [demo.posture[:, :ARM_JOINTS] for demo in read_demonstrations(arguments.data, "train")]
        for spec in files.keys() - stored.keys():
            stored[spec] = StoredDetector(DETECTORS.label(spec), DETECTORS[spec].fit(runs), metadata=dict(notes))
            save_detector(files[spec], stored[spec])  # what the trials run is what was stored
    with Pool(arguments.workers) as pool:
        validation = Validation(pool, world, arguments.encoder, arguments.seed)
        for path, policy in policies.items():
            for spec, file in files.items():
                if policy.hash in stored[spec].calibrations:
                    print(f"{path.name}, {spec}: calibrated already", flush=True)
                else:
                    _calibrate(arguments, validation, path, policy, spec, stored[spec])
                    save_detector(file, stored[spec])
    print(f"written: {', '.join(map(str, files.values()))}")
    return 0


def _check(arguments: BaselinesArguments) -> None:
    if not arguments.policies:
        raise InputError("no policy is given: give --policies one file or more")
    require_numbers(arguments, RANGES)
    episode_seeds("validation", arguments.seed, 1)  # there are some
    if UNFITTED & set(map(DETECTORS.label, arguments.detector)):
        raise InputError(
            "the recall is calibrated by diagrams/calibrate.py, never by nothing: choose another --detector"
        )
    if not arguments.detector or not arguments.factors or not arguments.betas:
        raise InputError(
            "there is no detector, factor or beta: give --detector, --factors and --betas one or more each"
        )
    if len({path.parent.resolve() for path in arguments.policies}) != 1:
        raise InputError("the policies lie in several folders: put them into one, where the detectors' files will be")


def _begun(file: Path, spec: str, notes: dict[str, Any]):
    """The StoredDetector that an earlier call left in `file`, if any; raises InputError where its notes differ."""
    from models.files.detectors import load_detector

    if not file.exists():
        return None
    found = load_detector(file, DETECTORS.label(spec))
    others = {name: found.metadata.get(name) for name in (*notes, "world")}
    if words := ", ".join(f"{name} ({value})" for name, value in others.items() if value != notes.get(name)):
        raise InputError(f"{file} was made with other {words}: give the same, or delete the file to calibrate anew")
    return found


def _calibrate(arguments: BaselinesArguments, validation: Validation, path: Path, policy, spec: str, stored) -> None:
    """Adds to the StoredDetector the calibration for the policy in `path`, and where it comes from."""
    criteria = make_detector(spec, policy, path.parent).GetOutputPort("errors").size()
    counts = {kind: arguments.episodes if kind == "none" else arguments.disturbed for kind in DISTURBANCES}
    runs = validation.run(Controller(path, spec, never_fires(criteria)), counts)
    found = by_count(runs.pop("none"), runs)
    print(f"{path.name}, {spec}, {found.words()}", flush=True)
    mean = found.mean_errors.tolist()

    def switched_right(beta: float, gamma: float) -> list[bool | None]:
        controller = Controller(path, spec, Calibration(tuple(mean), beta, gamma))
        trials = validation.run(controller, dict.fromkeys(DISTURBANCES, arguments.trials), "as_paper")
        outcomes = [run.outcome for kind in DISTURBANCES for run in trials[kind]]
        # By a false alarm the disturbance may have been kept away: such a void trial is a failure.
        return [False if found.void and found.false_switches else found.paper_switch_success for found in outcomes]

    beta, gamma, trials = best_in_loop(found.gamma, arguments.factors, arguments.betas, switched_right)
    print(f"{path.name}, {spec}: beta {beta:g}, gamma {gamma:.1f}", flush=True)
    stored.calibrations[policy.hash] = {"mean_errors": mean, "beta": beta, "gamma": gamma}
    peaks = {"normal": found.normal.tolist()} | {kind: peaks.tolist() for kind, peaks in found.disturbed.items()}
    stored.metadata[policy.hash] = {"policy": path.name, "peaks": peaks, "trials": trials}


if __name__ == "__main__":
    run(main, parse)
