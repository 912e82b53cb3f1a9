"""The bench's networks, and the detectors that are fitted to their runs: files in a folder of its own."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from diagrams.episodes.calibration import (
    RECALL,
    UNCALIBRATED,
    UNFITTED,
    Calibration,
    arrays_hash,
    detector_file,
    make_detector,
    policy_file,
    policy_name,
    require_named,
)
from diagrams.episodes.compatibility import require_trained_for
from diagrams.episodes.thresholds import Conformal, conformal
from diagrams.monitors.bench_plan import BenchArguments, Network
from diagrams.monitors.bench_task import Scored, load_tape
from diagrams.monitors.fitting import BETA, HELD_OUT
from diagrams.monitors.tapes import replay, require_sound
from diagrams.world.configuration import World
from diagrams.world.names import ARM_JOINTS, ENCODER
from diagrams.world.scenario import naming_file
from models.data.runs import SOURCES, Tape, fitted_for, learned, of_policy
from models.errors import InputError
from models.files.container import WeightsError, write_bytes
from models.files.detectors import StoredDetector, load_detector, save_detector
from systems.detector import NEVER
from systems.detectors import DETECTORS

NETWORKS = "networks"  # folder in --out
AGAIN = "Delete it: the same command makes it again"
TOLD = 0.5  # gamma of the detectors without a calibration: their error is alpha


def load_networks(arguments: BenchArguments, world: World) -> list[Network]:
    """The networks that are asked for, with their places in --out; raises InputError for what is amiss."""
    from models.inference import Encoder, Policy

    folder, source = arguments.out / NETWORKS, arguments.weights
    encoder_hash, networks = Encoder(source / ENCODER).hash, []
    for seed in dict.fromkeys(arguments.training_seeds):
        path = policy_file(source, arguments.rnn, seed)
        policy = Policy(path)
        require_named(policy, arguments.rnn, path)
        if policy.encoder_hash != encoder_hash:
            raise InputError(f"{path} was trained with another encoder than {ENCODER} beside it: give that one")
        with naming_file(path, "policy"):
            require_trained_for(world, policy)
        networks.append(Network(policy.name, seed, folder / policy_name(policy.name, seed), policy))
    return networks


def copy_networks(arguments: BenchArguments, networks: Sequence[Network]) -> None:
    """Copies them and their encoder beside where the detectors will be; raises InputError where others lie there.

    All of the kind are copied that lie in --weights: an ensemble takes the others too.
    """
    folder, source = arguments.out / NETWORKS, arguments.weights
    folder.mkdir(parents=True, exist_ok=True)
    for path in (source / ENCODER, *_of_kind(source, networks[0].rnn)):
        copy, content = folder / path.name, path.read_bytes()
        if copy.exists() and copy.read_bytes() != content:
            raise InputError(f"{arguments.out} was made with another {path.name}: choose another --out")
        if not copy.exists():
            write_bytes(copy, content)


def _of_kind(folder: Path, rnn: str) -> list[Path]:
    """Files of the networks of that kind, of all training seeds."""
    return sorted(path for path in folder.glob("*.onnx") if re.fullmatch(rf"{re.escape(rnn)}(-\d+)?", path.stem))


class Fitted:
    """The detectors of one network: fitted once, kept as files; what is there is not fitted again."""

    def __init__(self, network: Network, specs: Mapping[str, str], made_with: dict[str, Any]):
        """`specs` by label; `made_with`: plain types, what the runs of the fit are. See `fit`."""
        self.network, self._specs, self._made_with = network, dict(specs), json.loads(json.dumps(made_with))
        self.folder = network.path.parent
        self.means: dict[str, tuple[float, ...]] = {}

    def fit(self, tapes: Sequence[Path]) -> None:
        """Fits what has no file yet to the `tapes` of runs that did their task; the last quarter gives mean errors.

        Raises InputError for fewer than two tapes, and for a detector that has no error at all on them.
        """
        from tqdm import tqdm

        left = [label for label in self._specs if label not in UNCALIBRATED and not self._read(label)]
        if not left:
            return
        kept = len(tapes) - max(round(HELD_OUT * len(tapes)), 1)
        if kept < 1:
            raise InputError(f"{len(tapes)} undisturbed runs did their task, too few to fit to: raise --fit-runs")
        loaded = [load_tape(path, self.network.policy) for path in tapes]
        for label in tqdm(left, desc=f"{self.network.path.stem}: detectors", unit="fit", leave=False, disable=None):
            self._fit(label, loaded[:kept], loaded[kept:])

    def read(self) -> None:
        """Takes what an earlier start has fitted; raises InputError where a detector has not been."""
        for label in self._specs:
            if label not in UNCALIBRATED and not self._read(label):
                raise InputError(f"{self._file(label)} has nothing for {self.network.path.name}: run the bench again")

    def _read(self, label: str) -> bool:
        """Whether the file of an earlier start has it; raises InputError where it was fitted to other runs."""
        path = self._file(label)
        if not path.exists() or self.network.policy.hash not in (stored := load_detector(path, label)).metadata:
            return False
        found = stored.metadata[self.network.policy.hash]
        if _made_with(found) is None or found.keys() != {"made_with", "mean_errors"}:
            raise WeightsError(path, f"says {found!s:.60} of {self.network.path.name}, no mean errors", AGAIN)
        if found["made_with"].get("code", "") != DETECTORS.code(self._specs[label]):
            return False  # its author has changed it
        if found["made_with"] | {"code": ""} != self._made_with | {"code": ""}:
            raise InputError(f"{path} was fitted to other runs ({found['made_with']!s:.80}): choose another --out")
        size = make_detector(self._specs[label], self.network.policy, self.folder).GetOutputPort("errors").size()
        means = found["mean_errors"]
        if not isinstance(means, list) or len(means) != size or not all(_positive(value) for value in means):
            raise WeightsError(path, f"has the mean errors {means!s:.60}, no {size} finite numbers above 0", AGAIN)
        self.means[label] = tuple(means)
        return True

    def _file(self, label: str) -> Path:
        """Where it is kept; of one without arrays, so are its mean errors."""
        path = detector_file(self.folder, self._specs[label])
        return path.with_stem(f"{label}_means") if label in UNFITTED else path

    def _fit(self, label: str, tapes: list[Tape], held_out: list[Tape]) -> None:
        spec, policy, path = self._specs[label], self.network.policy, self._file(label)
        stored, code = load_detector(path, label) if path.exists() else StoredDetector(label), DETECTORS.code(spec)
        if any((_made_with(found) or {}).get("code", "") != code for found in stored.metadata.values()):
            stored = StoredDetector(label)
        if label != RECALL:
            stored.arrays |= self._learned(spec, tapes)
        with TemporaryDirectory() as folder:  # its own file has the mean errors too, from the beginning
            save_detector(Path(folder, path.name), stored)
            detector, home = make_detector(spec, policy, Path(folder)), policy.scaling.scale(policy.initial_posture)
        errors = [replay(detector, tape, home) for tape in held_out]
        require_sound(label, np.vstack(errors), np.vstack([replay(detector, held_out[0], home), *errors[1:]]))
        mean = np.vstack(errors).mean(axis=0)
        if not np.all(mean > 0.0):
            raise InputError(f"{label}: criterion {int(np.argmin(mean)) + 1} has no error at all on normal runs")
        self.means[label] = tuple(mean.tolist())
        made_with = self._made_with | ({"code": code} if code else {})
        stored.metadata[policy.hash] = {"made_with": made_with, "mean_errors": mean.tolist()}
        save_detector(path, stored)

    def _learned(self, spec: str, tapes: list[Tape]) -> dict[str, np.ndarray]:
        """The arrays, of this network or of all, as they are kept."""
        detector, policy = DETECTORS[spec], self.network.policy
        source = getattr(detector, "learns_from", "postures")
        if source not in SOURCES:
            raise InputError(f"the detector '{spec}' learns from '{source}': choose from {', '.join(SOURCES)}")
        if source == "policies":
            return learned(detector, [path.read_bytes() for path in _of_kind(self.folder, self.network.rnn)])
        runs: list[Any] = tapes
        if source == "postures":  # no demonstrations here: the same runs as all others
            runs = [policy.scaling.unscale(tape.posture)[:, :ARM_JOINTS] for tape in tapes]
        return fitted_for(policy.hash, learned(detector, runs))

    def scored(self, gammas: Mapping[str, float] | None = None) -> tuple[Scored, ...]:
        """The detectors with these `gammas`, by label; None: they are not known yet."""
        found = []
        for label, spec in self._specs.items():
            gamma = TOLD if label in UNCALIBRATED else NEVER if gammas is None else gammas[label]
            calibration = Calibration(self.means.get(label, (1.0,)), BETA, gamma)
            arrays = {}
            if label not in UNFITTED:
                arrays = of_policy(self.network.policy.hash, load_detector(self._file(label), label).arrays)
            made_of = f"{calibration!r}{DETECTORS.code(spec)}".encode()
            found.append(Scored(spec, calibration, arrays_hash(arrays, made_of)[:16]))
        return tuple(found)


def _made_with(found: Any) -> dict[str, Any] | None:
    """What the file of a detector says of the runs of its fit, and of its code; None: nothing."""
    made_with = found.get("made_with") if isinstance(found, dict) else None
    return made_with if isinstance(made_with, dict) else None


def _positive(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0.0 < value < np.inf


def gammas(specs: Mapping[str, str], rows: Sequence[dict[str, Any]], delta: float) -> dict[str, Conformal]:
    """By label, of the detectors with a calibration; `rows`: of all calibration runs, none is left out."""
    found = {}
    for label in specs:
        if label not in UNCALIBRATED:
            largest = [max(value for _, value in row["detectors"][label]["peaks"]) for row in rows]
            found[label] = conformal(np.array(largest), delta)
    return found
