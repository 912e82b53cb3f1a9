"""What a sweep is asked for, checked, and the episodes that this makes."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from diagrams.episodes.cores import cores
from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import MOST_WORKERS
from diagrams.episodes.sampling import SEED_BLOCKS, SEEDS_APART, episode_seeds
from diagrams.episodes.store import RowStore
from diagrams.sweeps.blocked import blocked_seeds, require_takes_arm
from diagrams.sweeps.cluster_options import ClusterOptions
from diagrams.sweeps.task import FILES, Task, own_code
from diagrams.world.configuration import World
from diagrams.world.faults.registry import is_fault, kind_label, require_kind, require_severity
from diagrams.world.names import DISTURBANCES, ENCODER, WEIGHTS
from diagrams.world.scenario import naming_file
from models.errors import InputError
from models.networks import network_label
from models.policy import POLICIES
from systems.detectors import DETECTORS
from systems.recoveries.registry import RECOVERIES, SHIPPED


@dataclass
class SweepArguments(ClusterOptions):
    """Every combination of the options that take several values is run, on the same episodes."""

    episodes: int = 40  # of each combination
    seed: int = 0  # episode i has the same scene and disturbance under every controller
    purpose: Literal["evaluation", "validation"] = "evaluation"  # whose scenes: remedies are chosen on validation
    way_home: Literal["any", "blocked"] = "any"  # blocked: only scenes whose straight way home touches something
    rnn: list[str] = field(default_factory=lambda: ["lstm"])  # lstm, gru, mtrnn, or package.module:Class
    policy: list[str] = field(default_factory=list)  # package.module:Class of one's own, instead of networks
    detector: list[str] = field(default_factory=lambda: ["recall"])  # as in the registry, or package.module:Class
    recovery: str = SHIPPED  # after an alarm: planned, backoff, regulator, hold, retrace, or package.module:Class
    disturbance: list[str] = field(default_factory=lambda: list(DISTURBANCES))  # none, A, B, moved, faults
    severity: list[float] = field(default_factory=lambda: [1.0])  # of the faults, 0 to 1
    training_seeds: list[int] = field(default_factory=lambda: [0])  # 0 is lstm.onnx, 1 is lstm-1.onnx
    until: Literal["task", "switching"] = "task"  # switching: ends once that has failed; the task is not judged
    stop_when_decided: bool = False  # of two controllers: no more of a disturbance whose tasks tell them apart
    gamma: list[float] = field(default_factory=list)  # in mean errors (the paper's rule, 3 there), not calibrated
    world: Path | None = None  # YAML file of the world, over the default one
    workers: int = field(default_factory=cores)  # processes of this machine; 0: this one
    weights: Path = WEIGHTS  # folder of the trained networks
    out: Path = Path("outputs/sweep")  # folder of rows.jsonl, episodes.parquet and summary.json
    keep_records: bool = False  # keep the record of each episode that is run in OUT/records
    mcap: bool = False  # write each episode that is run as an MCAP file to OUT/mcap
    retry_errors: bool = False  # run episodes that raised an error once more

    def check(self) -> None:
        """Raises InputError for a value outside its choices; of networks and detectors `plan` does."""
        for name in ("rnn", "detector", "disturbance", "severity", "training_seeds"):
            if not getattr(self, name):
                raise InputError(f"no {name.replace('_', ' ')} given: give one or more")
        RECOVERIES.check(self.recovery)
        for kind in self.disturbance:
            require_kind(kind)
        faults = [kind for kind in self.disturbance if is_fault(kind)]
        for severity in self.severity:
            require_severity((faults or self.disturbance)[0], severity)
        for what, number, least, most in (
            ("number of episodes", self.episodes, 1, SEEDS_APART),
            ("seed", self.seed, 0, SEED_BLOCKS - 1),
            ("number of workers", self.workers, 1, MOST_WORKERS),
            *(("training seed", seed, 0, 999) for seed in self.training_seeds),
        ):
            if not least <= number <= most:
                raise InputError(f"the {what} {number} is out of range: choose from {least} to {most}")
        networks = SweepArguments()
        for name in ("rnn", "training_seeds") if self.policy else ():
            if (value := getattr(self, name)) != getattr(networks, name):
                option, words = f"--{name.replace('_', '-')}", " ".join(map(str, value))
                raise InputError(f"{option} {words} is of networks, which --policy replaces: leave one out")
        self.check_cluster()
        for gamma in self.gamma:
            if not 0.0 < gamma < math.inf:
                raise InputError(f"the gamma {gamma} is out of range: choose a finite one above 0")
        controllers = len(self.policy or self.rnn) * len(self.detector) * max(len(self.gamma), 1)
        if self.stop_when_decided and (controllers != 2 or len(self.gamma) > 1 or self.until != "task"):
            raise InputError(
                f"--stop-when-decided compares the tasks of two controllers, here {controllers}: give two of --rnn, or "
                "of --detector, and no --until"
            )
        for option, given in (("--keep-records", self.keep_records), ("--mcap", self.mcap)):
            if given and self.until != "task":
                raise InputError(f"{option} keeps whole episodes, which --until switching cuts short: leave one out")


def plan(arguments: SweepArguments, world: World) -> tuple[list[Task], list[str]]:
    """The episodes in the order of the table, and the names of the weight files that they need.

    Raises InputError for an unknown network or detector, InputError or WeightsError for a file that is missing,
    damaged, or does not fit the others or the world.
    """
    from diagrams.episodes.calibration import (
        RECALL,
        UNCALIBRATED,
        UNFITTED,
        controller_of,
        detector_file,
        learned_hash,
        require_named,
        stored_calibration,
    )
    from diagrams.episodes.compatibility import require_trained_for
    from models.files.container import WeightsError
    from models.inference import Encoder, recall_file

    folder = arguments.weights
    detectors = _by_label(DETECTORS.label, arguments.detector)
    if arguments.gamma and (deaf := sorted(UNCALIBRATED & set(detectors))):
        raise InputError(f"--gamma says nothing to the detector '{deaf[0]}': leave one of the two out")
    names = {ENCODER}
    encoder_hash = Encoder(folder / ENCODER).hash
    gammas: list[float | None] = [*_unique(arguments.gamma)] or [None]
    controllers, hashes = [], dict[str, str]()
    networks = _by_label(network_label, [] if arguments.policy else arguments.rnn)
    asked_for: list[tuple[str, int, str | None]] = [
        *((rnn, seed, None) for rnn, seed in itertools.product(networks, _unique(arguments.training_seeds))),
        *((label, 0, spec) for label, spec in _by_label(POLICIES.label, arguments.policy).items()),
    ]
    for rnn, training_seed, spec in asked_for:
        controller = controller_of(folder, networks.get(rnn, rnn), RECALL, spec, training_seed)
        path = controller.policy
        name, policy = path.name, controller.load()
        if spec is None:
            names.add(name)
            require_named(policy, rnn, path)
        elif recall_file(folder, rnn).is_file():
            names.add(recall_file(folder, rnn).name)
        if policy.hash in hashes:
            raise WeightsError(folder / name, f"is the same file as {hashes[policy.hash]}", "Give each seed its own")
        hashes[policy.hash] = name
        if policy.encoder_hash not in ({encoder_hash} if spec is None else {encoder_hash, None}):
            raise WeightsError(folder / name, f"was trained with another encoder than {ENCODER}", "Give that one")
        with naming_file(path, "policy"):
            require_trained_for(world, policy)
        for detector, gamma in itertools.product(detectors.values(), gammas):
            own = stored_calibration(detector, policy, folder, gamma)
            label = DETECTORS.label(detector)
            fitted = label not in UNFITTED or (spec is not None and label == RECALL)
            if fitted:
                names.add(detector_file(folder, detector).name)
            learned = learned_hash(folder, detector, policy.hash) if fitted else None
            calibration = None if gamma is None else own
            controllers.append((rnn, training_seed, detector, gamma, policy.hash, learned, calibration, spec))
    kinds = list(_by_label(kind_label, arguments.disturbance).values())
    asked = arguments.purpose, arguments.seed, arguments.episodes
    blocked = arguments.way_home == "blocked"  # a search of minutes: last
    if blocked:
        require_takes_arm(kinds)
        with RowStore(arguments.out / "blocked.jsonl", fingerprint(world)) as store:
            seeds = {kind: blocked_seeds(world, *asked, kind, arguments.workers, store) for kind in kinds}
    else:
        seeds = dict.fromkeys(kinds, episode_seeds(*asked))
    files = tuple(name for name in FILES if (arguments.keep_records if name == "records" else arguments.mcap))
    severities: dict[str, list[float | None]] = {
        kind: [*_unique(arguments.severity)] if is_fault(kind) else [None] for kind in kinds
    }
    tasks = [
        Task(
            world, rnn, training_seed, detector, gamma, kind, seed, policy_hash, encoder_hash, learned, calibration,
            arguments.until, files, spec, severity, own_code(detector, kind, arguments.recovery), arguments.recovery,
        )
        for rnn, training_seed, detector, gamma, policy_hash, learned, calibration, spec in controllers
        for kind in kinds
        for severity in severities[kind]
        for seed in seeds[kind]
    ]  # fmt: skip
    return tasks, sorted(names)


def _unique(values: list) -> list:
    return list(dict.fromkeys(values))


def _by_label(label_of: Callable[[str], str], specs: list[str]) -> dict[str, str]:
    """`specs` by the short names under which rows and files are kept; raises InputError for two with one name."""
    found: dict[str, str] = {}
    for spec in specs:
        label = label_of(spec)
        if found.setdefault(label, spec) != spec:
            raise InputError(f"{found[label]} and {spec} both have the name '{label}': give one of them another")
    return found
