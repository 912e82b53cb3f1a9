"""`bench.py offline`: detectors on recorded runs of anybody's arm and policy, of which no hidden state is known."""

import collections
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import System

from diagrams.episodes.calibration import UNCALIBRATED
from diagrams.episodes.thresholds import Conformal, conformal
from diagrams.monitors.bench_table import with_interval
from diagrams.monitors.metrics import Monitored, measured
from diagrams.monitors.scoring import Score, largest_before
from diagrams.monitors.tapes import replay, require_sound
from models.checks import LARGEST_SEED, require_numbers, require_plain
from models.command_line import require, require_writable
from models.data.motions import Motion, read_motions
from models.data.runs import Tape, learned
from models.data.scaling import MinMaxScaling
from models.data.windows import WINDOW
from models.errors import InputError
from models.files.container import write_text
from systems.detectors import DETECTORS

RESULT = "offline.json"  # in --out
LEAST = 8  # runs that did their task
USES = {"fit": 0.4, "means": 0.1, "calibration": 0.25}  # shares of these, by what they are for; the others are judged
FIELDS = ("tpr", "tnr", "balanced_accuracy", "auroc", "auprc", "twa", "false_alarms_per_hour")
UNKNOWN = ("predicted_features", "active", "network_input", "reset")  # inputs that are of a policy in the loop
HIDDEN = "it needs the network's hidden state, or what comes of it"


@dataclass(frozen=True)
class Arm:
    """What detectors ask of a policy, of one that is not known: sizes, scaling, period.

    In the place of the features of a picture stand state and action, scaled: (M + A,).
    """

    scaling: MinMaxScaling
    actions: MinMaxScaling
    period: float
    horizon: int = WINDOW
    state_size: int = 0

    @classmethod
    def of(cls, motions: list[Motion], period: float) -> "Arm":
        """Scaled by the range of these runs."""
        states, actions = (np.vstack([getattr(motion, name) for motion in motions]) for name in ("states", "actions"))
        return cls(MinMaxScaling.from_data(states), MinMaxScaling.from_data(actions), period)

    @property
    def posture_size(self) -> int:
        """M."""
        return len(self.scaling.lower)

    @property
    def feature_size(self) -> int:
        """M + A."""
        return self.posture_size + len(self.actions.lower)

    @property
    def metadata(self) -> dict[str, Any]:
        """The period of the ticks, s."""
        return {"world": {"period": self.period}}

    def tape(self, motion: Motion) -> Tape:
        """The run as the ports of a detector have it; 0 where nothing is known."""
        posture, ticks = self.scaling.scale(motion.states), len(motion.states)
        features = np.hstack((posture, self.actions.scale(motion.actions)))
        recalled = np.zeros((ticks, self.horizon + 1, self.posture_size))
        return Tape(posture, recalled, np.zeros((ticks, 0)), features, np.zeros_like(features), np.zeros(ticks))

    def errors(self, detector: System, motion: Motion) -> np.ndarray:
        """(T, E) of `detector`, raw; before the first tick the arm was where it begins."""
        tape = self.tape(motion)
        return replay(detector, tape, tape.posture[0])


class NotServed(InputError):
    """A detector that needs what these runs do not have."""


def make_offline(spec: str, arm: Arm, motions: list[Motion], joints: int) -> System:
    """The detector, fitted to these runs; raises NotServed where it needs more than states and actions."""
    kind = DETECTORS[spec]
    reads, source = getattr(kind, "reads", ()), getattr(kind, "learns_from", "postures")
    if DETECTORS.label(spec) in UNCALIBRATED or source == "policies" or reads == ("hidden_state",):
        raise NotServed(HIDDEN)
    tapes: list[Any] = [arm.tape(motion) for motion in motions]
    runs = [motion.states[:, :joints] for motion in motions] if source == "postures" else tapes
    try:
        detector = kind.build(arm, joints, learned(kind, runs))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"the detector '{spec}' cannot be fitted to these runs: {error}") from error
    recalls = detector.GetInputPort("recalled_postures").get_index()
    unknown = [name for name in UNKNOWN if detector.HasInputPort(name)]
    if unknown or detector.HasDirectFeedthrough(recalls, detector.GetOutputPort("errors").get_index()):
        raise NotServed(HIDDEN)
    return detector


@dataclass
class Offline:
    """Fits detectors to recorded runs that did their task, calibrates them on others by split conformal prediction and
    judges them on the rest and on those that failed. Those that need the network's hidden state are left out; those
    that judge hidden state and picture judge state and action. Writes OUT/offline.json."""

    data: list[Path]  # robomimic's HDF5 files, or folders of LeRobotDatasets v3, of one arm
    detectors: list[str] = field(default_factory=list)  # as for a bench; none named: all that can be
    state: list[str] = field(default_factory=list)  # observations that make a state; observation.state, and posture
    joints: int | None = None  # the first so many components of a state are joints; all
    period: float | None = None  # s, of the ticks, where the data do not say it
    delta: float = 0.05  # share of the runs that did their task with a false alarm, at most, as far as these allow
    seed: int = 0  # which runs are for what
    out: Path = Path("outputs/offline")  # folder of what is found

    def run(self) -> int:
        """Judges, prints and writes the table; returns the exit code."""
        from tqdm import tqdm

        require("pandas", "pyarrow", "scipy", "sklearn")
        require_numbers(self, {"joints": (1, 10_000), "period": (1e-4, 100.0), "seed": (0, LARGEST_SEED)})
        if not 0.0 < self.delta < 1.0:
            raise InputError(f"--delta {self.delta} is no share: choose one between 0 and 1, such as 0.05")
        if not self.data:
            raise InputError("--data names no file: give one or more")
        require_plain(self.out / RESULT, "choose another --out")
        named = self.detectors or [*DETECTORS]
        for spec in named:
            DETECTORS.check(spec)
        uses = self._uses(motions := self._motions())
        arm = Arm.of(uses["fit"], self._period(motions))
        if (joints := self.joints or arm.posture_size) > arm.posture_size:
            raise InputError(f"--joints {joints} is more than the {arm.posture_size} components of a state: take fewer")
        require_writable(self.out / RESULT)
        found, left_out = list[dict[str, Any]](), dict[str, str]()
        for spec in tqdm(named, desc="detectors", unit="detector", leave=False, disable=None):
            try:
                detector = make_offline(spec, arm, uses["fit"], joints)
                found.append(_judged(spec, detector, arm, uses, self.delta))
            except NotServed as error:
                if self.detectors:
                    raise InputError(f"{spec}: {error}: leave it out") from error
                left_out[spec] = str(error)
        if not found:
            raise InputError("no detector can judge these runs: name others by --detectors")
        counts = {use: len(runs) for use, runs in uses.items()}
        counts |= {"failed": sum(motion.success is False for motion in motions)}
        result = {"runs": counts, "period": arm.period, "delta": self.delta, "detectors": found, "left_out": left_out}
        write_text(self.out / RESULT, json.dumps(result, indent=1) + "\n")
        print(_text(result), f"written: {self.out / RESULT}", sep="\n")
        return 0

    def _motions(self) -> list[Motion]:
        """All runs; raises InputError for those of two arms, for one that comes twice, or is shorter than a window."""
        found = [motion for path in self.data for motion in read_motions(path, self.state)]
        widths = [(motion.states.shape[1], motion.actions.shape[1]) for motion in found]
        for name, times in collections.Counter(motion.name for motion in found).items():
            if times > 1:
                raise InputError(f"{times} runs of --data are called {name}: give each once, under a name of its own")
        for motion, width in zip(found, widths, strict=True):
            if width != widths[0]:
                raise InputError(
                    f"{motion.name} has states and actions of {width} components, others {widths[0]}: "
                    "give runs of one arm"
                )
            if len(motion.states) < WINDOW:
                raise InputError(
                    f"{motion.name} has {len(motion.states)} ticks: leave it out, {WINDOW} or more are needed"
                )
        return found

    def _period(self, motions: list[Motion]) -> float:
        periods = {self.period or motion.period for motion in motions}
        if len(periods) != 1 or (period := periods.pop()) is None:
            raise InputError("--data do not say one period of their ticks: give --period, in s")
        return period

    def _uses(self, motions: list[Motion]) -> dict[str, list[Motion]]:
        """What each run is for; where no one says what came of it, all did their task."""
        done = [motion for motion in motions if motion.success is not False]
        if len(done) < LEAST:
            raise InputError(f"{len(done)} of the runs did their task, {LEAST} or more are needed: add some")
        order = [done[i] for i in np.random.default_rng(self.seed).permutation(len(done))]
        uses, first = dict[str, list[Motion]](), 0
        for use, share in USES.items():
            last = first + max(round(share * len(done)), 1)
            uses[use], first = order[first:last], last
        return uses | {"judged": order[first:] + [motion for motion in motions if motion.success is False]}


def _judged(spec: str, detector: System, arm: Arm, uses: dict[str, list[Motion]], delta: float) -> dict[str, Any]:
    """What the detector says of the judged runs, and what that is worth."""
    errors = {use: [arm.errors(detector, motion) for motion in runs] for use, runs in uses.items() if use != "fit"}
    parts = [part for use in errors.values() for part in use]
    require_sound(spec, np.vstack(parts), np.vstack([arm.errors(detector, uses["means"][0]), *parts[1:]]))
    mean = np.vstack(errors["means"]).mean(axis=0)
    if not np.all(mean > 0.0):
        raise NotServed(
            f"criterion {int(np.argmin(mean)) + 1} has no error at all on runs that did their task (if that is a "
            "joint that never moves, give fewer --joints)"
        )
    ratios = {use: [(part / mean).max(axis=1) for part in errors[use]] for use in ("calibration", "judged")}
    gamma: Conformal = conformal(np.array([ratio.max() for ratio in ratios["calibration"]]), delta)
    judged, scores = uses["judged"], [Score.of(ratio, gamma.gamma, None) for ratio in ratios["judged"]]
    length = np.array([len(motion.states) for motion in judged]) * arm.period
    failed = np.array([motion.success is False for motion in judged])
    shortest, n = min(len(motion.states) for motion in judged), len(judged)
    alarm = np.array([np.nan if score.alarm is None else score.alarm * arm.period for score in scores])
    values = measured(
        Monitored(
            scene=np.arange(n), training_seed=np.zeros(n, int), onset=np.full(n, np.nan), alarm=alarm,
            score=np.array([largest_before(score.peaks, shortest) for score in scores]), length=length, needed=failed,
            false_alarms=np.where(failed, 0, [score.false_alarms for score in scores]),
            normal_time=np.where(failed, 0.0, length), success=~failed, oracle_success=~failed, lost=np.zeros(n),
        )
    )  # fmt: skip
    return {
        "detector": DETECTORS.label(spec), "n": n, "failed": int(failed.sum()), "mean_errors": mean.tolist(),
        "gamma": gamma.gamma, "average": gamma.average, "share": gamma.share, **{name: values[name] for name in FIELDS},
        "of_runs": {
            motion.name: {
                "success": motion.success, "largest": score.peaks[-1][1],
                "alarm_s": None if score.alarm is None else score.alarm * arm.period,
            }
            for motion, score in zip(judged, scores, strict=True)
        },
    }  # fmt: skip


def _text(result: dict[str, Any]) -> str:
    """The table, a line a detector; and who is left out."""
    found = result["detectors"]
    width = max([len(entry["detector"]) for entry in found], default=0) + 2
    lines = [", ".join(f"{use} {count}" for use, count in result["runs"].items())]
    lines.append(f"{'detector':{width}s}" + "".join(f"{name:>22s}" for name in FIELDS))
    for entry in found:
        words = "".join(f"{with_interval(entry[name]):>22s}" for name in FIELDS)
        lines.append(f"{entry['detector']:{width}s}{words}")
    for reason in dict.fromkeys(result["left_out"].values()):
        names = ", ".join(name for name, why in result["left_out"].items() if why == reason)
        lines.append(f"left out, {reason}: {names}")
    return "\n".join(lines)
