"""Fits and calibrates detectors for networks: the two baselines of Table II, and all others but the recall.

    python diagrams/baselines.py --policies models/weights/lstm*.onnx --data demonstrations.h5
    python diagrams/baselines.py --policies runs/lstm.onnx --detector innovation rnd --rule conformal --seed 2

1. Each detector learns: from the training demonstrations in --data, or from --fit-runs undisturbed validation episodes
   that the network does with the detector off (those that do their task), or nothing.
2. --rule trials: mean errors and gamma come from validation episodes with the detector off: see by_count in
   diagrams/episodes/thresholds.py. Then trials in closed loop on validation episodes: that gamma times each factor with
   the first beta, then the best with the other betas; the largest share switched right is taken, in the paper's words
   (diagrams/episodes/switching.py), since these detectors let go of the arm on its way home.
   --rule conformal: a quarter of the runs of the fit, kept from it, gives the mean errors; gamma is split conformal, by
   the --episodes of --seed, beta the paper's. One simulation serves all detectors.

Writes a file a detector (knn.safetensors, ...) beside the networks, after each network; the same command goes on after
a kill, and one with more policies adds them. Exit code 2: bad input.
"""

import dataclasses
import os
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from diagrams.episodes.calibration import UNFITTED, Calibration, Controller, detector_file, make_detector, never_fires
from diagrams.episodes.pool import MOST_WORKERS, Pool
from diagrams.episodes.sampling import SEEDS_APART, episode_seeds
from diagrams.episodes.thresholds import best_in_loop, by_count
from diagrams.episodes.validation import Validation
from diagrams.monitors.fitting import Tapes, calibrate, fit
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, DISTURBANCES, ENCODER, WEIGHTS
from diagrams.world.scenario import load_world
from models.checks import Range, require_numbers
from models.command_line import run
from models.data.runs import SOURCES, learned
from models.errors import InputError
from models.files.container import locked
from systems.detectors import DETECTORS

RANGES: dict[str, Range] = {
    "episodes": (1, SEEDS_APART), "disturbed": (1, SEEDS_APART), "trials": (1, SEEDS_APART),
    "fit_runs": (2, SEEDS_APART), "workers": (0, MOST_WORKERS), "factors": (1e-3, 1e3), "betas": (1e-3, 1e6),
}  # fmt: skip
TABLE_II = ("knn", "subspace")
# Arguments that decide what is written, by the rule; and those of the fit to a network's runs.
NOTED = {
    "trials": ("seed", "episodes", "disturbed", "trials", "factors", "betas"),
    "conformal": ("rule", "seed", "episodes", "disturbed", "delta", "fit_seed", "fit_runs"),
}
FIT = ("fit_seed", "fit_runs")


@dataclass
class BaselinesArguments:
    """Command line of baselines.py."""

    policies: list[Path]  # policy files, all in one folder
    data: Path | None = None  # demonstrations of diagrams/teach.py, for detectors that learn from them
    # names of detectors, or package.module:Class
    detector: list[str] = field(default_factory=lambda: list(TABLE_II))
    rule: Literal["trials", "conformal"] = "trials"  # how gamma and beta are chosen
    world: Path | None = None  # YAML file of the world that the episodes run in
    encoder: Path = WEIGHTS / ENCODER  # file of the encoder
    episodes: int = 60  # undisturbed validation episodes
    disturbed: int = 60  # validation episodes of each of A and B
    trials: int = 10  # validation episodes of each of none, A and B in closed loop, for each gamma and beta
    factors: list[float] = field(default_factory=lambda: [1.0, 0.5, 0.25, 2.0])  # of gamma; the first of the best wins
    betas: list[float] = field(default_factory=lambda: [30.0, 10.0, 100.0])  # the first of the best wins
    seed: int = 0  # 0 to 99: which validation episodes; conformal: not 0, on which networks were selected
    fit_seed: int = 3  # 0 to 99: which validation episodes a detector learns from, if it does from a network's runs
    fit_runs: int = 40  # how many of these
    delta: float = 0.01  # conformal: share of undisturbed runs with a false alarm, at most, as far as --episodes allows
    workers: int = 2  # processes; 0: this one


def parse(arguments: list[str] | None = None) -> BaselinesArguments:
    """The command line."""
    return tyro.cli(BaselinesArguments, args=arguments, description=__doc__)


def main(arguments: BaselinesArguments) -> int:
    """Writes a file a detector beside the policies; returns the exit code."""
    _check(arguments)
    # What two programs add to the same files at a time would be lost.
    with locked(arguments.policies[0].parent / "baselines.lock", "folder of --policies"):
        return _run(arguments)


def _run(arguments: BaselinesArguments) -> int:
    from models.files.detectors import StoredDetector, save_detector
    from models.inference import Policy

    world = load_world(arguments.world)
    policies = {path: Policy(path) for path in arguments.policies}
    files = {spec: detector_file(arguments.policies[0].parent, spec) for spec in arguments.detector}
    notes = {spec: _notes(arguments, world, spec, policies) for spec in files}
    stored = {spec: found for spec, file in files.items() if (found := _begun(file, spec, notes[spec]))}
    for spec in [spec for spec in files if spec not in stored]:
        arrays = _learned(arguments, spec, policies)
        stored[spec] = StoredDetector(DETECTORS.label(spec), arrays, metadata=dict(notes[spec]))
        save_detector(files[spec], stored[spec])  # what the trials run is what was stored
    with Pool(arguments.workers) as pool:
        validation = Validation(pool, world, arguments.encoder, arguments.seed)
        for path, policy in policies.items():
            left = [spec for spec in files if policy.hash not in stored[spec].calibrations]
            for spec in (spec for spec in files if spec not in left):
                print(f"{path.name}, {spec}: calibrated already", flush=True)
            tapes = _tapes(arguments, pool, world, path, policy, left)
            for spec in left:
                file, found = files[spec], stored[spec]
                if _source(spec) == "network" and not any(name.startswith(policy.hash) for name in found.arrays):
                    assert tapes is not None
                    found.arrays |= fit(spec, policy, tapes.fit)
                    save_detector(file, found)
                if arguments.rule == "trials":
                    _calibrate(arguments, validation, path, policy, spec, found)
                else:
                    assert tapes is not None
                    print(f"{path.name}, {spec}:", end=" ", flush=True)
                    make = partial(make_detector, spec, policy, path.parent)
                    found.calibrations[policy.hash], words = calibrate(tapes, make, arguments.delta)
                    found.metadata[policy.hash] = {"policy": path.name, "calibration": words}
                save_detector(file, found)
    print(f"written: {', '.join(map(str, files.values()))}")
    return 0


def _source(spec: str) -> str:
    """What the detector learns from, of SOURCES in models/data/runs.py."""
    source = getattr(DETECTORS[spec], "learns_from", "postures")
    if source not in SOURCES:
        raise InputError(f"the detector '{spec}' learns from '{source}': choose from {', '.join(SOURCES)}")
    return source


def _notes(arguments: BaselinesArguments, world: World, spec: str, policies: dict[Path, Any]) -> dict[str, Any]:
    """What a file of the detector must have been made with to go on with it."""
    from models.data.demonstrations import read_header

    names, source = NOTED[arguments.rule], _source(spec)
    if source == "network":
        names = tuple(dict.fromkeys((*names, *FIT)))
    notes = {name: getattr(arguments, name) for name in names}
    if source == "postures":
        if arguments.data is None:
            raise InputError(f"the detector '{spec}' learns from demonstrations: give --data")
        notes = {"data": read_header(arguments.data).content_hash} | notes
    if source == "policies":
        notes["policies"] = sorted(policy.hash for policy in policies.values())
    return notes if world == World() else notes | {"world": dataclasses.asdict(world)}


def _learned(arguments: BaselinesArguments, spec: str, policies: dict[Path, Any]) -> dict[str, np.ndarray]:
    """The arrays of a file that are not of one network alone."""
    source = _source(spec)
    if source == "postures":
        from models.data.demonstrations import read_demonstrations

        assert arguments.data is not None
        runs = [demo.posture[:, :ARM_JOINTS] for demo in read_demonstrations(arguments.data, "train")]
        return learned(DETECTORS[spec], runs)
    if source == "policies":
        if len(kinds := {policy.name for policy in policies.values()}) > 1:
            raise InputError(f"the detector '{spec}' takes networks of one kind, not {', '.join(sorted(kinds))}")
        return learned(DETECTORS[spec], [path.read_bytes() for path in policies])
    return {}


def _tapes(arguments: BaselinesArguments, pool: Pool, world: World, path: Path, policy, specs: list[str]):
    """The runs that `specs` are fitted to and, by the conformal rule, calibrated on; None: none are needed."""
    conformal = arguments.rule == "conformal"
    if not specs or not (conformal or "network" in map(_source, specs)):
        return None
    counts = {kind: arguments.episodes if kind == "none" else arguments.disturbed for kind in DISTURBANCES}
    return Tapes.run(
        pool, world, arguments.encoder, path, policy, fit=(arguments.fit_seed, arguments.fit_runs),
        calibration=(arguments.seed, counts if conformal else {}),
    )  # fmt: skip


def _check(arguments: BaselinesArguments) -> None:
    if not arguments.policies:
        raise InputError("no policy is given: give --policies one file or more")
    require_numbers(arguments, RANGES)
    for seed in (arguments.seed, arguments.fit_seed):
        episode_seeds("validation", seed, 1)  # there are some
    if arguments.rule == "conformal" and arguments.seed in (0, arguments.fit_seed):
        raise InputError(
            f"--seed {arguments.seed} is that of the fit, or the 0 that networks are selected on: choose another for "
            "--rule conformal"
        )
    if not 0.0 < arguments.delta < 1.0:
        raise InputError(f"--delta {arguments.delta} is no share: choose one between 0 and 1, such as 0.01")
    if UNFITTED & set(map(DETECTORS.label, arguments.detector)):
        raise InputError(
            "the recall is calibrated by diagrams/calibrate.py, never and oracle by nothing: choose another --detector"
        )
    if not arguments.detector or not arguments.factors or not arguments.betas:
        raise InputError(
            "there is no detector, factor or beta: give --detector, --factors and --betas one or more each"
        )
    if len({os.path.realpath(path.parent) for path in arguments.policies}) != 1:
        raise InputError("the policies lie in several folders: put them into one, where the detectors' files will be")
    for path in arguments.policies:
        if not path.is_file():
            raise InputError(f"--policies {path} is no file: give the file of a network")


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
