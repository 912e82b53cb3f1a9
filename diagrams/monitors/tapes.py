"""Tapes: runs with the detector off, as the ports of any detector had them. One simulation serves all detectors."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.systems.framework import System

from diagrams.episodes.calibration import Controller
from diagrams.episodes.episode import Outcome
from diagrams.episodes.pool import Pool
from diagrams.episodes.record import Record
from diagrams.episodes.runner import Job, prepared
from diagrams.episodes.sampling import episode_seeds
from diagrams.episodes.switching import Until
from diagrams.world.configuration import World
from models.data.runs import Tape
from models.errors import InputError

WATCHED = ("hidden_state", "predicted_features", "recalled_postures")  # outputs of the controller; read a tick later


@dataclass(frozen=True)
class TapedRun:
    """What came of a run with the detector off, and its tape."""

    outcome: Outcome
    tape: Tape
    onset: int | None  # tick at whose update the disturbance began, or the fault
    end: int  # first tick after it; without one, ticks of the run


def run_taped(job: Job) -> TapedRun:
    """Runs one in a worker; its controller never alarms."""
    return taped_and_recorded(job)[0]


def taped_and_recorded(job: Job) -> tuple[TapedRun, Record]:
    """The same, and the run's record, as large as its tape."""
    rollout, episode, calibration = prepared(job)
    rows: dict[str, list[np.ndarray]] = {name: [] for name in WATCHED}
    acts = list[float]()

    def keep(ticks: int) -> None:
        context = rollout.controller.GetMyContextFromRoot(rollout.simulator.get_context())
        for name in WATCHED:
            rows[name].append(rollout.controller.GetOutputPort(name).Eval(context).copy())
        acts.append(float(rollout.judged("acting")[0]))

    more = dict(until=job.until, picture_every=job.picture_every, calibration=calibration)
    outcome, record = rollout.run(episode, on_tick=keep, **more)
    policy = rollout.policy
    size, ticks = policy.posture_size, len(record.time)
    home = np.clip(policy.scaling.scale(policy.initial_posture), -1.0, 1.0)
    first = {
        "hidden_state": np.asarray(policy.initial_state, float),
        "predicted_features": np.zeros(policy.feature_size),
        "recalled_postures": np.tile(home, policy.horizon + 1),
    }
    before = {name: np.array([first[name], *rows[name]])[:ticks] for name in WATCHED}
    before["recalled_postures"] = before["recalled_postures"].reshape(ticks, -1, size)
    active = np.array(acts) > 0.5
    tape = Tape(
        # With alpha at 0 the network is fed what was measured.
        posture=record.network_input[:, :size],
        features=record.network_input[:, size:],
        active=np.append(0.0, active[:-1]),
        **before,
    )
    onset = int(np.argmax(active)) if active.any() else None
    return TapedRun(outcome, tape, onset, ticks if onset is None else onset + int(active.sum())), record


def taped(
    pool: Pool, world: World, encoder: Path, controller: Controller, seed: int, counts: Mapping[str, int]
) -> dict[str, list[TapedRun]]:
    """So many validation episodes of `seed` of each kind of disturbance, by kind, in the order of their seeds.

    A disturbed one ends with the disturbance. `controller`: its detector is off.
    """
    from tqdm import tqdm

    seeds = episode_seeds("validation", seed, max(counts.values()))
    ends: dict[str, Until] = {kind: "task" if kind == "none" else "detection" for kind in counts}
    jobs = [
        Job(world, encoder, controller, s, kind, until=ends[kind]) for kind in counts for s in seeds[: counts[kind]]
    ]
    found = {}
    with tqdm(total=len(jobs), desc=f"{controller.policy.stem} tapes", unit="run", leave=False, disable=None) as bar:
        for job, run in pool.run(run_taped, jobs):
            found[job.kind, job.seed] = run
            bar.update()
    return {kind: [found[kind, s] for s in seeds[:count]] for kind, count in counts.items()}


def replay(detector: System, tape: Tape, initial_posture: np.ndarray) -> np.ndarray:
    """The errors (T, E) that `detector`, in a fresh Context, gives on the run of `tape`: those of that run, to the bit.

    `initial_posture`: (M,) scaled, which stands for every posture before the first tick. Of a detector whose Context
    has a calibration only by default: errors are raw.
    """
    context = detector.CreateDefaultContext()
    ports = {port.get_name(): port for port in map(detector.get_input_port, range(detector.num_input_ports()))}
    errors, ticks = detector.GetOutputPort("errors"), len(tape.posture)
    depth = ports["posture_history"].size() // len(initial_posture)
    postures = np.vstack((np.tile(initial_posture, (depth - 1, 1)), tape.posture))
    given = {
        "posture_history": np.array([postures[k : k + depth][::-1].ravel() for k in range(ticks)]),
        "network_input": np.hstack((tape.posture, tape.features)),
        "reset": np.zeros((ticks, 1)),
        "active": tape.active[:, None],
    }
    given |= {name: getattr(tape, name).reshape(ticks, -1) for name in (*WATCHED, "features")}
    found = []
    for k in range(ticks):
        for name, port in ports.items():
            port.FixValue(context, given[name][k])
        found.append(errors.Eval(context).copy())
        if context.num_discrete_state_groups():
            context.SetDiscreteState(detector.EvalUniquePeriodicDiscreteUpdate(context))
    return np.array(found)


def require_sound(detector: str, errors: np.ndarray, again: np.ndarray) -> None:
    """Raises InputError unless the `errors` of a run are finite numbers, and the same when it was replayed `again`."""
    if not np.isfinite(errors).all():
        raise InputError(f"the detector '{detector}' has errors that are no finite numbers: leave it out")
    if not np.array_equal(errors, again):
        raise InputError(
            f"the detector '{detector}' has other errors when the same run is replayed: keep what it remembers in its "
            "Context"
        )
