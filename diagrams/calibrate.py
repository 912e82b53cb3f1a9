"""Selects a trained network by closed-loop rollouts on validation scenes, and calibrates its detector on others.

    python diagrams/calibrate.py --candidates runs/lstm/policy-*.onnx --out models/weights/lstm.onnx

1. Each candidate runs --episodes undisturbed validation episodes of --seed with the detector off; those that finish
   most go on. Of several, the one is taken that finishes most disturbed ones too (then: fastest undisturbed), its gamma
   the largest score of the undisturbed.
2. The mean errors come from those undisturbed runs, gamma from --runs others, of --calibration-seed, on which nothing
   was trained or selected: split conformal, see `conformal` in diagrams/episodes/thresholds.py. None is left out.
3. Disturbed runs of that seed say how many are missed at gamma, and whether a gamma bounds both.

With --policy package.module:Class it calibrates --detector for that policy by the same steps, and writes, or adds to,
the detector's file OUT.

Exit code 2: bad input.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from diagrams.episodes.calibration import (
    RECALL,
    UNCALIBRATED,
    UNFITTED,
    Calibration,
    Controller,
    arrays_hash,
    detector_file,
    make_detector,
    never_fires,
)
from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import MOST_WORKERS, Pool
from diagrams.episodes.sampling import SEEDS_APART, episode_seeds
from diagrams.episodes.store import RowStore
from diagrams.episodes.switching import DETECTED
from diagrams.episodes.thresholds import ValidationRun, conformal, mean_errors, misses, scores, spans
from diagrams.episodes.validation import Validation, tally
from diagrams.world.names import ENCODER, WEIGHTS
from diagrams.world.scenario import load_world
from models.checks import require_apart, require_numbers
from models.command_line import require, require_writable, run
from models.errors import InputError
from models.policy import POLICIES
from systems.detectors import DETECTORS

BETA = 30.0  # the paper's


@dataclass
class CalibrateArguments:
    """Command line of calibrate.py."""

    out: Path  # the calibrated copy of the best candidate; with --policy FOLDER/DETECTOR.safetensors
    candidates: list[Path] = field(default_factory=list)  # policy files with recall heads
    policy: str | None = None  # package.module:Class of one's own (models/policy.py), instead of candidates
    detector: str = RECALL  # calibrated for --policy; what it has learned is in OUT, or beside --encoder
    world: Path | None = None  # YAML file of the world that the episodes run in
    encoder: Path = WEIGHTS / ENCODER  # file of the encoder
    episodes: int = (
        20  # undisturbed validation episodes a candidate, and disturbed ones of each of A and B if it's close
    )
    runs: int = 300  # undisturbed validation episodes for gamma
    disturbed: int = 100  # validation episodes of each of A and B for the misses
    delta: float = 0.01  # share of undisturbed runs with a false alarm, at most, as far as --runs allows to say it
    seed: int = 0  # 0 to 99: which validation episodes select the network and give its mean errors
    calibration_seed: int = 2  # 0 to 99: which validation episodes give gamma
    kept: Path = Path("outputs/calibration")  # folder of the finished episodes: the same command goes on after a kill
    workers: int = 2  # processes; 0: this one

    def check(self) -> None:
        """Raises InputError for a value outside its choices."""
        require_writable(self.out)
        require_apart({"--out": self.out}, {"--world": self.world, "--encoder": self.encoder})
        if bool(self.candidates) == (self.policy is not None):
            raise InputError(
                "no candidate is given, or a policy too: give --candidates one file or more, or give --policy"
            )
        if self.policy is None and self.detector != RECALL:
            raise InputError(f"--detector {self.detector} goes with --policy: for networks run diagrams/baselines.py")
        if self.policy is not None and (label := DETECTORS.label(self.detector)) in UNCALIBRATED:
            raise InputError(f"the detector '{label}' has nothing to calibrate: choose another")
        if self.policy is not None and self.out.name != (name := detector_file(Path(), self.detector).name):
            raise InputError(f"--out {self.out} is not how the detector's file is found: call it {name}")
        counts = dict.fromkeys(("episodes", "runs", "disturbed"), (1, SEEDS_APART))
        require_numbers(self, counts | {"workers": (0, MOST_WORKERS)})
        if not 0.0 < self.delta < 1.0:
            raise InputError(f"--delta {self.delta} is no share: choose one between 0 and 1, such as 0.01")
        for seed, count in ((self.seed, self.episodes), (self.calibration_seed, max(self.runs, self.disturbed))):
            episode_seeds("validation", seed, count)  # there are some
        if self.seed == self.calibration_seed:
            raise InputError(
                f"--seed and --calibration-seed are both {self.seed}: choose two, selection may not see the other's"
            )


def parse(arguments: list[str] | None = None) -> CalibrateArguments:
    """The command line."""
    return tyro.cli(CalibrateArguments, args=arguments, description=__doc__)


def main(arguments: CalibrateArguments) -> int:
    """Writes `arguments.out`; returns the exit code."""
    arguments.check()
    require("scipy")
    from models.files.container import file_hash
    from models.files.detectors import save_detector
    from models.files.policies import read_policy, write_policy
    from models.inference import Policy

    world = load_world(arguments.world)
    learned: dict[str, str] = {}
    if arguments.policy is not None:
        stored, off = begun(arguments)
        learned["learned"] = arrays_hash(stored.arrays)
    else:
        off = {
            path: Controller(path, calibration=never_fires(Policy(path).horizon + 1)) for path in arguments.candidates
        }
    rooms = [f"diagrams/episodes/{name}.py" for name in ("thresholds", "validation")]
    made_with = fingerprint(world, *rooms, encoder=file_hash(arguments.encoder), **learned)
    stem = "-".join(
        part for part in (arguments.policy and POLICIES.label(arguments.policy), arguments.out.stem) if part
    )
    kept = arguments.kept / f"{stem}.jsonl"
    with Pool(arguments.workers) as pool, RowStore(kept, made_with, "--kept") as store:
        selecting, calibrating = (
            Validation(pool, world, arguments.encoder, seed, store)
            for seed in (arguments.seed, arguments.calibration_seed)
        )
        chosen, normal, tallies = select(off, selecting, arguments.episodes)
        counts = {"none": arguments.runs} | dict.fromkeys("AB", arguments.disturbed)
        runs = calibrating.run(off[chosen], counts)
    means = mean_errors(normal)
    found = {"none": scores([run.before for run in runs["none"]], means)}
    found |= {kind: scores([run.after for run in runs[kind]], means) for kind in "AB"}
    gamma = conformal(found["none"], arguments.delta)
    # How far above gamma an error is at which alpha counts as noticed.
    margin = float(np.log(DETECTED / (1.0 - DETECTED)) / BETA)
    missed = {kind: misses(found[kind], gamma.gamma, margin, arguments.delta) for kind in "AB"}
    words = [gamma.words(), *(part.words(kind, gamma.gamma) for kind, part in missed.items())]
    print(f"{chosen.name}, largest error by its mean: {spans(found)}", *words, sep="\n", flush=True)
    notes = {
        "chosen": chosen.name,
        "selection": {f"{path.parent.name}/{path.name}": entry for path, entry in tallies.items()},
        "seeds": {"selection and mean errors": arguments.seed, "gamma": arguments.calibration_seed},
        "undisturbed": tally(f"{chosen.name}, none, for gamma", runs["none"]),
        "scores": {kind: np.sort(part).tolist() for kind, part in found.items()},
        "gamma": {"rank": gamma.rank, "runs": gamma.n, "average": gamma.average, "share": gamma.share},
        "missed": {kind: vars(part) for kind, part in missed.items()},
        "words": words,
    }
    if arguments.policy is not None:
        policy = off[chosen].load()
        stored.calibrations[policy.hash] = {"mean_errors": means.tolist(), "beta": BETA, "gamma": gamma.gamma}
        stored.metadata[policy.hash] = {"policy": policy.name, "calibration": notes}
        save_detector(arguments.out, stored)
        print(f"written: {arguments.out}, the calibration of {policy.name} added")
        return 0
    facts, graph = read_policy(chosen)
    metadata = {**facts.metadata, "calibration": notes}
    calibrated = replace(facts, mean_errors=means, beta=BETA, gamma=gamma.gamma, metadata=metadata)
    write_policy(arguments.out, calibrated, graph.content)
    print(f"{chosen.name} is taken; written: {arguments.out}")
    return 0


def begun(arguments: CalibrateArguments) -> tuple[Any, dict[Path, Controller]]:
    """The StoredDetector that the calibration is added to, and --policy with that detector off, by its stand-in path.

    What the detector has learned is copied to OUT if that is not there. Raises InputError as `make_policy` and
    `make_detector` do, WeightsError for a detector's file that is damaged, or missing where it has to learn.
    """
    from models.files.container import write_bytes
    from models.files.detectors import StoredDetector, load_detector

    out, spec, label = arguments.out, arguments.policy, DETECTORS.label(arguments.detector)
    assert spec is not None
    path = out.parent / POLICIES.label(spec)
    policy = Controller(path, spec=spec).load()
    learns = getattr(DETECTORS[arguments.detector], "learns_from", "postures") != "nothing"
    if label not in UNFITTED and learns and not out.is_file():
        learned = arguments.encoder.parent / out.name
        load_detector(learned, label)  # it is one
        write_bytes(out, learned.read_bytes())
    stored = load_detector(out, label) if out.is_file() else StoredDetector(label)
    criteria = make_detector(arguments.detector, policy, out.parent).GetOutputPort("errors").size()
    return stored, {path: Controller(path, arguments.detector, never_fires(criteria), spec)}


def select(
    off: dict[Path, Controller], validation: Validation, episodes: int
) -> tuple[Path, list[ValidationRun], dict[Path, dict[str, Any]]]:
    """The best of the candidates, its undisturbed runs, and how the tasks of each went, by kind of disturbance.

    `off`: each with its detector off. Raises InputError where none finishes a task.
    """
    undisturbed, tallies = {}, {}
    for path, controller in off.items():
        undisturbed[path] = validation.run(controller, {"none": episodes})["none"]
        tallies[path] = {"none": tally(f"{path.name}, none", undisturbed[path])}
    most = max(entry["none"]["successes"] for entry in tallies.values())
    if not most:
        raise InputError(f"no candidate finished one of {episodes} tasks: train longer, then calibrate")
    finalists = [path for path, entry in tallies.items() if entry["none"]["successes"] == most]
    if len(finalists) > 1:
        for path in finalists:
            means = mean_errors(undisturbed[path])
            gamma = float(scores([run.before for run in undisturbed[path]], means).max())
            controller = replace(off[path], calibration=Calibration(tuple(means), BETA, gamma))
            disturbed = validation.run(controller, dict.fromkeys("AB", episodes), "task")
            tallies[path] |= {kind: tally(f"{path.name}, {kind}", runs) for kind, runs in disturbed.items()}

    def score(path: Path) -> tuple[int, float]:
        recoveries = sum(entry["successes"] for kind, entry in tallies[path].items() if kind != "none")
        return recoveries, -tallies[path]["none"]["mean_seconds"]

    chosen = max(finalists, key=score)
    return chosen, undisturbed[chosen], tallies


if __name__ == "__main__":
    run(main, parse)
