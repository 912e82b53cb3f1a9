"""Fits detectors to a network's own runs, and calibrates them by split conformal prediction, on tapes alone."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import System

from diagrams.episodes.calibration import Controller, never_fires
from diagrams.episodes.pool import Pool
from diagrams.episodes.switching import DETECTED
from diagrams.episodes.thresholds import conformal, misses, spans
from diagrams.monitors.tapes import TapedRun, replay, taped
from diagrams.world.configuration import World
from models.data.runs import Tape, fitted_for, learned
from models.errors import InputError
from systems.detectors import DETECTORS

BETA = 30.0  # the paper's
HELD_OUT = 0.25  # of the runs for the fit: they give the mean errors, those that were fitted to would be too small


@dataclass(frozen=True)
class Tapes:
    """The validation runs of a network with the detector off, and what they are for; none is in two of them."""

    policy: Any  # see models/inference.py
    fit: list[Tape]  # undisturbed, the task done
    held_out: list[Tape]  # likewise
    undisturbed: list[TapedRun]  # for gamma; none is left out
    disturbed: dict[str, list[TapedRun]]  # by kind

    @classmethod
    def run(
        cls,
        pool: Pool,
        world: World,
        encoder: Path,
        path: Path,
        policy: Any,
        *,
        fit: tuple[int, int],
        calibration: tuple[int, Mapping[str, int]],
    ) -> "Tapes":
        """Runs them: `fit` has a validation seed and how many, `calibration` another one and how many of each kind.

        Raises InputError where too few of the undisturbed runs did their task.
        """
        off = Controller(path, "never", never_fires(1))
        runs = taped(pool, world, encoder, off, fit[0], {"none": fit[1]})["none"]
        done = [run.tape for run in runs if run.outcome.success]
        kept = len(done) - max(round(HELD_OUT * len(done)), 1)
        if kept < 1:
            raise InputError(f"{len(done)} of {fit[1]} undisturbed runs did their task: raise --fit-runs")
        others = taped(pool, world, encoder, off, *calibration) if any(calibration[1].values()) else {}
        return cls(policy, done[:kept], done[kept:], others.pop("none", []), others)

    def errors(self, detector: System, tape: Tape) -> np.ndarray:
        """(T, E) of `detector`, raw."""
        scaling, initial = self.policy.scaling, np.asarray(self.policy.initial_posture, float)
        return replay(detector, tape, scaling.scale(initial))


def fit(spec: str, policy: Any, tapes: Sequence[Tape]) -> dict[str, np.ndarray]:
    """What the detector learns from `tapes` of `policy`, under the names of a file with other networks'."""
    return fitted_for(policy.hash, learned(DETECTORS[spec], list(tapes)))


def calibrate(tapes: Tapes, make: Callable[[], System], delta: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """Mean errors, beta and gamma of the detector that `make` makes, and where they come from; prints what gamma means.

    Raises InputError for a criterion without any error on normal runs.
    """
    from tqdm import tqdm

    detector, found = make(), dict[str, np.ndarray]()
    everything = len(tapes.held_out) + len(tapes.undisturbed) + sum(map(len, tapes.disturbed.values()))
    with tqdm(total=everything, desc="scores", unit="run", leave=False, disable=None) as bar:

        def errors(tape: Tape) -> np.ndarray:
            bar.update()
            return tapes.errors(detector, tape)

        mean = np.vstack([errors(tape) for tape in tapes.held_out]).mean(axis=0)
        if not np.all(mean > 0.0):
            raise InputError(f"criterion {int(np.argmin(mean)) + 1} has no error at all on normal runs: fit on others")
        found["none"] = np.array([(errors(run.tape) / mean).max() for run in tapes.undisturbed])
        for kind, runs in tapes.disturbed.items():
            parts = [(errors(run.tape) / mean)[run.onset : run.end] for run in runs if run.onset is not None]
            found[kind] = np.array([part.max() for part in parts if len(part)])
    gamma = conformal(found["none"], delta)
    margin = float(np.log(DETECTED / (1.0 - DETECTED)) / BETA)
    missed = {kind: misses(found[kind], gamma.gamma, margin, delta) for kind in tapes.disturbed if len(found[kind])}
    words = [gamma.words(), *(part.words(kind, gamma.gamma) for kind, part in missed.items())]
    print(f"largest error by its mean: {spans(found)}", *words, sep="\n", flush=True)
    notes = {
        "scores": {kind: np.sort(part).tolist() for kind, part in found.items()},
        "gamma": {"rank": gamma.rank, "runs": gamma.n, "average": gamma.average, "share": gamma.share},
        "missed": {kind: vars(part) for kind, part in missed.items()},
        "words": words,
    }
    return {"mean_errors": mean.tolist(), "beta": BETA, "gamma": gamma.gamma}, notes
