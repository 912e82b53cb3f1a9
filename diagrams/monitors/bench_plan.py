"""What the bench is asked for, checked, and the episodes that this makes."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from diagrams.episodes.cores import cores
from diagrams.episodes.pool import MOST_WORKERS
from diagrams.episodes.sampling import SEED_BLOCKS, SEEDS_APART, episode_seeds
from diagrams.monitors.bench_task import BenchTask, Scored, Stage
from diagrams.sweeps.cluster_options import ClusterOptions
from diagrams.world.configuration import World
from diagrams.world.faults.registry import FAULTS, is_fault, kind_label, require_kind, require_severity
from diagrams.world.names import DISTURBANCES, WEIGHTS
from models.checks import Range, require_numbers
from models.errors import InputError
from systems.detectors import DETECTORS
from systems.recoveries.registry import RECOVERIES, SHIPPED

NEVER, ORACLE = "never", "oracle"  # the two that every detector is measured by
NONE = "none"  # the undisturbed episodes, which every table has
FIT_SEED, CALIBRATION_SEED = 3, 4  # blocks of validation episodes
Controller = tuple[str, str]  # short name of a detector; recovery
RANGES: dict[str, Range] = {
    "episodes": (1, SEEDS_APART), "seed": (0, SEED_BLOCKS - 1), "training_seeds": (0, 999),
    "fit_runs": (2, SEEDS_APART), "calibration_runs": (1, SEEDS_APART), "workers": (0, MOST_WORKERS),
    "severities": (0.0, 1.0),
}  # fmt: skip


@dataclass
class BenchArguments(ClusterOptions):
    """Every detector on every fault at every severity; what alarms is run again with every recovery."""

    detectors: list[str] = field(default_factory=lambda: [*DETECTORS])  # as in the registry, or package.module:Class
    # short names of those that act in closed loop, the oracle beside them; the others are scored alone. None: all act
    loop: list[str] | None = None
    # of two that --loop names, or one and `never`: no more of a fault whose tasks tell them apart; without the oracle
    stop_when_decided: bool = False
    faults: list[str] = field(default_factory=lambda: [*DISTURBANCES[1:], *FAULTS])  # A, B, ...; none is always there
    severities: list[float] = field(default_factory=lambda: [1.0])  # of the faults, 0 to 1
    episodes: int = 1  # scenes of each fault and severity
    seed: int = 0  # which scenes; episode i has the same under everything
    training_seeds: list[int] = field(default_factory=lambda: [0])  # 0 is lstm.onnx, 1 is lstm-1.onnx
    recoveries: list[str] = field(
        default_factory=lambda: [SHIPPED]
    )  # planned, backoff, regulator, hold, retrace, or package.module:Class
    rnn: str = "lstm"  # whose networks
    fit_runs: int = 12  # undisturbed validation episodes that the detectors learn from; a quarter gives the mean errors
    calibration_runs: int = 20  # others, that gamma comes from
    delta: float = 0.05  # share of undisturbed runs with a false alarm, at most, as far as these allow
    weights: Path = WEIGHTS  # folder of the networks; the detectors are fitted here
    world: Path | None = None  # YAML file of the world, over the default one
    workers: int = field(default_factory=cores)  # processes of this machine; 0: this one
    # folder of the rows, the fitted detectors, bench.parquet, summary.json, bench.png and explorer.html
    out: Path = Path("outputs/bench")
    # key of an episode in --out, as explorer.html names it: its 3-D replay and pictures for that page, nothing else
    replay: str | None = None

    def check(self) -> None:
        """Raises InputError for a value outside its choices; of networks `load_networks` does."""
        for name in ("detectors", "faults", "severities", "training_seeds", "recoveries"):
            if not getattr(self, name):
                raise InputError(f"--{name.replace('_', '-')} names nothing: give one or more")
        require_numbers(self, RANGES)
        self.check_cluster()
        if not 0.0 < self.delta < 1.0:
            raise InputError(f"--delta {self.delta} is no share: choose one between 0 and 1, such as 0.05")
        for kind in self.faults:
            require_kind(kind)
        for kind in filter(is_fault, self.faults):
            for severity in self.severities:
                require_severity(kind, severity)
        by_label(DETECTORS.label, self.detectors)
        if self.loop == []:
            raise InputError("--loop names nothing: give one detector or more, or leave it out for all")
        for label in self.loop or ():
            if label not in self.specs:
                raise InputError(
                    f"--loop {label:.80} is none of the detectors here: choose from {', '.join(self.specs)}, or name "
                    "it in --detectors too"
                )
        for spec in self.recoveries:
            RECOVERIES.check(spec)
        by_label(RECOVERIES.label, self.recoveries)
        if self.stop_when_decided:
            self.compared  # noqa: B018

    def require_replay_of(self, bench: "BenchArguments") -> None:
        """Raises InputError for an option beside --replay that is not what that `bench` was run with."""
        by_itself = BenchArguments(out=self.out, replay=self.replay, workers=self.workers)
        for name, value in vars(self).items():
            if value not in (getattr(by_itself, name), getattr(bench, name)):
                option = f"--{name.replace('_', '-')}"
                raise InputError(f"{option} {value} says nothing to --replay, for which --out says all: leave it out")

    @property
    def specs(self) -> dict[str, str]:
        """The detectors by their short names, with those that all are measured by."""
        return by_label(DETECTORS.label, [NEVER, ORACLE, *self.detectors])

    @property
    def acting(self) -> set[str]:
        """The short names of those that act in closed loop: where one does, the oracle too, whose gap it closes."""
        named = {*self.specs} if self.loop is None else {NEVER, *self.loop}
        return named | ({ORACLE} if named != {NEVER} and not self.stop_when_decided else set())

    @property
    def compared(self) -> tuple[Controller, Controller]:
        """The two of --stop-when-decided; raises InputError where there are more of them, or fewer."""
        acting = [name for name in dict.fromkeys(self.loop or ()) if name != NEVER]
        two = [(label, recovery) for label in acting for recovery in dict.fromkeys(self.recoveries)]
        if len(two) == 1:
            two.append((NEVER, two[0][1]))
        if len(two) != 2:
            raise InputError(
                f"--stop-when-decided compares two that act in the closed loop, here {len(two)}: give --loop two "
                "detectors, or one, to compare it with never, and --recoveries one; or one detector and two recoveries"
            )
        return two[0], two[1]

    @property
    def kinds(self) -> list[tuple[str, float | None]]:
        """What disturbs, each with a severity if it has one; the undisturbed first."""
        named = by_label(kind_label, [NONE, *self.faults]).values()
        severities: list[float | None] = [*dict.fromkeys(self.severities)]
        return [(kind, severity) for kind in named for severity in (severities if is_fault(kind) else [None])]


def by_label(label_of, specs: Iterable[str]) -> dict[str, str]:
    """`specs` by their short names; raises InputError for two with one name."""
    found: dict[str, str] = {}
    for spec in specs:
        if found.setdefault(label := label_of(spec), spec) != spec:
            raise InputError(f"{found[label]} and {spec} both have the name '{label}': give one of them another")
    return found


@dataclass(frozen=True)
class Network:
    """One network of the bench: the detectors are fitted and calibrated for it."""

    rnn: str
    training_seed: int
    path: Path
    policy: Any  # see models/inference.py


def undisturbed(
    arguments: BenchArguments, world: World, network: Network, stage: Stage, detectors: tuple[Scored, ...] = ()
) -> list[BenchTask]:
    """The validation episodes that the detectors of `network` are fitted to, or calibrated on."""
    seed, count = (FIT_SEED, arguments.fit_runs) if stage == "fit" else (CALIBRATION_SEED, arguments.calibration_runs)
    return [
        BenchTask(stage, world, network.rnn, network.training_seed, NONE, None, s, network.policy.hash, detectors)
        for s in episode_seeds("validation", seed, count)
    ]


def switched_off(
    arguments: BenchArguments, world: World, network: Network, detectors: tuple[Scored, ...]
) -> list[BenchTask]:
    """The evaluation episodes with the detector off, on which all `detectors` are scored."""
    found, name, seed, policy = list[BenchTask](), network.rnn, network.training_seed, network.policy.hash
    for kind, severity in arguments.kinds:
        own = _beside(detectors, FAULTS.code(kind) if is_fault(kind) else "")
        seeds = episode_seeds("evaluation", arguments.seed, arguments.episodes)
        found += [BenchTask("off", world, name, seed, kind, severity, s, policy, own) for s in seeds]
    return found


def in_loop(arguments: BenchArguments, task: BenchTask, row: dict[str, Any]) -> Iterator[BenchTask]:
    """What acts in the episode of `task`, which left `row`: each acting detector that alarmed, with each recovery."""
    if row["error"] is not None or row["void"]:
        return
    acting = arguments.acting
    for scored in task.detectors:
        found = row["detectors"][scored.label]
        if scored.label not in acting:
            continue
        if found["alarm"] is None and not found["false_alarms"]:
            continue
        for recovery in by_label(RECOVERIES.label, arguments.recoveries).values():
            yield BenchTask(
                "loop", task.world, task.rnn, task.training_seed, task.kind, task.severity, task.seed,
                task.weights_hash, _beside((scored,), RECOVERIES.code(recovery)), recovery,
            )  # fmt: skip


def _beside(detectors: tuple[Scored, ...], code: str) -> tuple[Scored, ...]:
    """Those whose rows are of another fault, or recovery, once its `code` is another."""
    return tuple(replace(scored, hash=scored.hash + code) for scored in detectors) if code else detectors
