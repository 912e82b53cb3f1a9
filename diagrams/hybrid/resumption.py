"""The region of resumption: from which states the loop closes again within 6 s, and the subtask is done.

Starts are sampled in the whole system (resumption_starts.py), for both rules by which the network comes back at home:
it starts anew, or has imagined its way to the end. V (resumption_time.py) says of each start, from the network alone,
when it resumes; its largest level from which all starts have resumed in the whole system is the region.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from diagrams.episodes.calibration import Controller, stored_calibration
from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import Pool, kept_in_thread
from diagrams.episodes.runner import Job, build_rollout
from diagrams.episodes.sampling import EpisodeSampler, episode_seeds
from diagrams.episodes.store import RowStore
from diagrams.episodes.switching import RESUME_SECONDS
from diagrams.hybrid.common import NetworkArguments
from diagrams.hybrid.return_proof import bound
from diagrams.world.configuration import RESUMPTIONS
from models.errors import InputError

STARTS_A_SCENE = 30  # and subtask
FINISH_SECONDS = 30.0  # that a subtask has
PATIENCE = 2.0  # starts are followed for so many times RESUME_SECONDS
SUBTASKS = (1, 2)


@dataclass
class Resume(NetworkArguments):
    """The region of resumption: from which states the loop closes again within 6 s, and the subtask is done."""

    starts: int = 3000  # for each subtask and rule
    finished: int = 300  # of them, whose subtask is run to its end
    workers: int = 2

    LEAST: ClassVar[dict[str, int]] = {"starts": 1, "finished": 0, "workers": 0}

    def run(self) -> int:
        """Samples; returns 0 if under the world's rule every start resumes, else 1."""
        from diagrams.drawing.resumption import save_resumption
        from models.inference import Encoder, Policy

        world, encoder, policy = self.world(), Encoder(self.encoder_path), Policy(self.policy_path)
        if policy.gamma is None:
            raise InputError(f"{self.policy_path} has no calibration: run diagrams/calibrate.py on it")
        scenes = -(-self.starts // STARTS_A_SCENE)
        seeds = episode_seeds("resumption", self.seed, scenes)
        finished = -(-min(self.finished, self.starts) // scenes)
        jobs = [
            ResumeJob(Job(replace(world, resumption=rule), self.encoder_path, Controller(self.policy_path), seed),
                      rule, self.seed, finished)
            for rule in RESUMPTIONS for seed in seeds
        ]  # fmt: skip
        chosen = {"weights": policy.hash, "encoder": encoder.hash, "finished": finished}
        path = self.out / "resume_starts.jsonl"
        with RowStore(path, fingerprint(world, "diagrams/hybrid", **chosen)) as store, Pool(self.workers) as pool:
            rows = _rows(jobs, store, pool)
        period = world.timing.period
        rules = {
            rule: {
                str(subtask): judge([row for row in rows[rule] if row[0] == subtask][: self.starts], period)
                for subtask in SUBTASKS
            }
            for rule in RESUMPTIONS
        }
        self.write("resume", {"policy": policy.hash, "rule": world.resumption, "scenes": scenes, "rules": rules})
        save_resumption(rows, period, self.out / "resume.png")
        path.unlink()  # it is for a run that is broken off
        for rule, found in rules.items():
            for subtask, entry in found.items():
                print(_words(rule, subtask, entry))
        return 1 if any(entry["not_resumed"] for entry in rules[world.resumption].values()) else 0


@dataclass(frozen=True)
class ResumeJob:
    """The starts of one scene under one rule."""

    job: Job
    rule: str
    seed: int
    finished: int  # of each subtask's starts, run to the end

    @property
    def key(self) -> str:
        """In the store."""
        return f"{self.rule}-{self.job.seed}"


# Of one start: subtask; largest deviation of a joint, deg; V and the ticks to resume, None: more than those followed;
# whether the subtask was done, None: not looked at.
Row = tuple[int, float, int | None, int | None, bool | None]


def run_job(given: ResumeJob) -> list[Row]:
    """In a worker: the starts of a scene."""
    from diagrams.hybrid.resumption_starts import Resumptions, Start
    from diagrams.hybrid.resumption_time import time_to_resume

    job = given.job

    def make() -> Resumptions:
        rollout, controller = build_rollout(job.world, job.encoder, job.controller), job.controller
        return Resumptions(rollout, stored_calibration(controller.detector, rollout.policy, controller.policy.parent))

    system = kept_in_thread(("resumptions", repr(job.world), job.controller), make)
    sampler = kept_in_thread(("sampler", repr(job.world)), lambda: EpisodeSampler(job.world))
    policy, period = system.rollout.policy, job.world.timing.period
    points, monitor = system.switching_points(sampler.sample(job.seed, "none", rnn=policy.name))
    limit, found = round(PATIENCE * RESUME_SECONDS / period), list[Row]()
    for point in points:
        rng = np.random.default_rng([given.seed, job.seed, point.subtask])
        for i in range(STARTS_A_SCENE):
            start = Start.drawn(point, policy, rng)
            rows = system.way_home(start.offset)
            predicted = time_to_resume(policy, start.memory, rows, system.gain, limit, given.rule == "reset")
            finish = round(FINISH_SECONDS / period) if i < given.finished else 0
            resumed, done = system.resume(point, start, monitor, limit, finish)
            farthest = float(np.rad2deg(np.abs(start.offset).max()))
            found.append((point.subtask, farthest, predicted, resumed, done))
    return found


def _rows(jobs: Sequence[ResumeJob], store: RowStore, pool: Pool) -> dict[str, list[Row]]:
    """The starts of each rule; what is in the store is not run again."""
    from tqdm import tqdm

    missing = [job for job in jobs if job.key not in store.rows]
    with tqdm(total=len(jobs), initial=len(jobs) - len(missing), desc="resume", unit="scene", disable=None) as bar:
        for job, found in pool.run(run_job, missing):
            store.add(job.key, found)
            bar.update()
    return {
        rule: [tuple(row) for job in jobs if job.rule == rule for row in store.rows[job.key]] for rule in RESUMPTIONS
    }


def judge(rows: Sequence[Row], period: float) -> dict[str, Any]:
    """The report of a subtask's starts, plain types; `period`: of the ticks, s."""
    limit = round(RESUME_SECONDS / period)
    followed = round(PATIENCE * RESUME_SECONDS / period) + 1  # stands for None
    predicted, measured = (np.array([followed if row[i] is None else row[i] for row in rows], int) for i in (2, 3))
    failed, foretold = measured > limit, predicted > limit
    # The largest level below all starts that failed.
    lowest = int(predicted[failed].min()) if failed.any() else followed
    inside = predicted <= min(limit, lowest - 1)
    level = int(predicted[inside].max()) if inside.any() else None
    seconds = measured[~failed] * period
    done = [row[4] for row in rows if row[4] is not None]
    off = np.abs(predicted - measured)[(predicted < followed) & (measured < followed)]
    return {
        "samples": len(rows),
        "not_resumed": int(failed.sum()),
        "bound": bound(int(failed.sum()), len(rows)),
        "foretold": int(foretold.sum()),
        "foretold_wrongly": int((foretold != failed).sum()),
        "largest_error_ticks": int(off.max(initial=0)),
        "level_ticks": level,
        "inside": int(inside.sum()),
        "inside_bound": bound(0, int(inside.sum())) if inside.any() else 1.0,
        "time_s": {
            "median": float(np.median(seconds)), "p95": float(np.quantile(seconds, 0.95)), "max": float(seconds.max()),
        } if len(seconds) else None,
        "finished": {
            "samples": len(done), "failures": len(done) - sum(done), "bound": bound(len(done) - sum(done), len(done)),
        } if done else None,
    }  # fmt: skip


def _words(rule: str, subtask: str, found: dict[str, Any]) -> str:
    """The report of a rule and a subtask, in words."""
    time, done = found["time_s"], found["finished"]
    text = (
        f"{rule}, subtask {subtask}: {found['not_resumed']} of {found['samples']} starts do not resume within "
        f"{RESUME_SECONDS:g} s (95 % bound {found['bound']:.1e}), {found['foretold']} were foretold, "
        f"{found['foretold_wrongly']} wrongly; all {found['inside']} with V up to {found['level_ticks']} ticks resume"
    )
    if time is not None:
        text += f"; after {time['median']:.1f} s (median), {time['max']:.1f} s at most"
    if done is not None:
        text += f"; {done['failures']} of {done['samples']} subtasks not done"
    return text
