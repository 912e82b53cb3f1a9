"""The region of resumption: from which states the loop closes again within 6 s, and the subtask is done.

Starts are sampled in the whole system (resumption_starts.py), under both rules by which the network comes back at home:
it starts anew, or has imagined its way to the end. T (resumption_time.py) says of each start, from the network alone,
when it resumes; its largest level from which all starts have resumed in the whole system is the region. Disturbed runs
of their own test it: T where each arm came home says which of them will not resume in time.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from typing import Any, ClassVar

import numpy as np

from diagrams.episodes.calibration import Controller, stored_calibration
from diagrams.episodes.pool import MOST_WORKERS, Pool, kept_in_thread
from diagrams.episodes.runner import Job, build_rollout, run_episode
from diagrams.episodes.sampling import SEED_BLOCKS, EpisodeSampler, episode_seeds
from diagrams.episodes.store import RowStore, of_plain
from diagrams.hybrid.box_gauge import BoxGauge
from diagrams.hybrid.common import NetworkArguments, fingerprint_with_analyses
from diagrams.hybrid.resumption_report import (
    Row,
    RunRow,
    by_scene,
    finished_by_scene,
    followed_ticks,
    judge,
    judge_runs,
    words,
    words_of_runs,
)
from diagrams.hybrid.resumption_starts import KINDS, Memory, Resumptions, Start, way_home
from diagrams.hybrid.resumption_time import time_to_resume
from diagrams.world.configuration import RESUMPTIONS, World
from diagrams.world.names import ARM_JOINTS
from diagrams.world.task import HOME_TOLERANCE
from models.checks import Range
from models.errors import InputError

STARTS_A_SCENE = 15  # of a kind
FINISH_SECONDS = 30.0  # that a subtask has
MOST_SCENES = 5000  # the seeds after them are of the disturbed runs


@dataclass
class Resume(NetworkArguments):
    """The region of resumption: from which states the loop closes again within 6 s, and the subtask is done."""

    starts: int = 3000  # of each kind, under the world's rule
    compared: int = 300  # of these, which are run under the other rule too
    runs: int = 200  # disturbed ones, half of them A
    workers: int = 2  # processes; 0: this one

    NAME: ClassVar[str] = "resume"
    RANGES: ClassVar[dict[str, Range]] = {
        "seed": (0, SEED_BLOCKS - 1), "starts": (1, STARTS_A_SCENE * MOST_SCENES), 
        "compared": (0, STARTS_A_SCENE * MOST_SCENES), "runs": (0, MOST_SCENES), "workers": (0, MOST_WORKERS),
    }  # fmt: skip

    def run(self) -> int:
        """Samples; returns 0 if under the world's rule every start resumes, else 1."""
        from diagrams.drawing.resumption import save_resumption

        world, (encoder, policy, _) = self.loaded_world(), self.calibrated()
        chosen = {"weights": policy.hash, "encoder": encoder.hash}
        path = self.out / "resume_starts.jsonl"
        job, seeds = Job(world, self.encoder_path, Controller(self.policy_path)), self._seeds()
        with RowStore(path, fingerprint_with_analyses(world, **chosen)) as store, Pool(self.workers) as pool:
            rows, scenes = self._starts(job, seeds[:MOST_SCENES], store, pool)
            period = world.timing.period
            runs = judge_runs(self._runs(job, seeds[MOST_SCENES:], store, pool), period)
            rules = {
                rule: {
                    kind: judge([row for row in rows if (row.rule, row.kind) == (rule, kind)], period) for kind in KINDS
                }
                for rule in (RESUMPTIONS if self.compared else (world.resumption,))
            }
            worst = worst_ticks(policy, world)
            found = {
                "fingerprint": fingerprint_with_analyses(world), "policy": policy.hash, "encoder_hash": encoder.hash,
                "rule": world.resumption, "scenes": scenes, "rules": rules,
                "by_scene": {rule: by_scene([row for row in rows if row.rule == rule], period) for rule in rules},
                "finished_by_scene": finished_by_scene(rows),
                "worst_ticks": worst, "runs": runs,
            }  # fmt: skip
            self.write(found)
            save_resumption([asdict(row) for row in rows], period, self.out / "resume.png")
            path.unlink(missing_ok=True)  # it is for a run that is broken off; while no other program can open it
        for rule, kind in product(rules, KINDS):
            print(words(rule, kind, rules[rule][kind]))
        print(f"starting anew from the farthest posture at home takes {worst} ticks")
        print(words_of_runs(runs))
        return 1 if any(entry["not_resumed"] for entry in rules[world.resumption].values()) else 0

    def _seeds(self) -> list[int]:
        """Of the scenes, MOST_SCENES of them, then of the disturbed runs."""
        return episode_seeds("resumption", self.seed, MOST_SCENES + max(self.runs, 1))

    def _starts(self, job: Job, seeds: list[int], store: RowStore, pool: Pool) -> tuple[list["Row"], dict[str, Any]]:
        """The starts of each kind and rule; how many scenes they took, and how many gave none of a kind."""
        from tqdm import tqdm

        done, own = list[list[Row]](), job.world.resumption
        with tqdm(total=self.starts * len(KINDS), desc="resume", unit="start", disable=None) as bar:
            for jobs in self._batches(job, seeds, done):
                missing = [given for given in jobs if given.key not in store.rows]
                for given, found in pool.run(run_scene, missing):
                    store.add(given.key, [asdict(row) for row in found])
                    bar.update(min(sum(row.rule == own for row in found), bar.total - bar.n))
                done.extend(store.read(given.key, partial(of_plain, list[Row])) for given in jobs)
                bar.n = sum(
                    min(count, self.starts) for count in counts(done, own)
                )  # what is too much of a kind is left out
                bar.refresh()
        without = {kind: sum(all(row.kind != kind for row in scene) for scene in done) for kind in KINDS}
        rows = [row for scene in done for row in scene]
        chosen = [
            row
            for rule, kind in product(RESUMPTIONS, KINDS)
            for row in [row for row in rows if (row.rule, row.kind) == (rule, kind)][
                : self.starts if rule == own else min(self.compared, self.starts)
            ]
        ]
        return chosen, {"seen": len(done), "without": without}

    def _batches(self, job: Job, seeds: list[int], done: list[list["Row"]]) -> Iterator[list["SceneJob"]]:
        """Scenes, as many as the kind that lacks most in `done` still needs: those under both rules first."""
        begun, own = 0, job.world.resumption
        [other] = set(RESUMPTIONS) - {own}
        while (lacking := self.starts - min(counts(done, own))) > 0 and begun < len(seeds):
            compared = min(self.compared, self.starts) - min(counts(done, other))
            rules = RESUMPTIONS if compared > 0 else (own,)
            wanted = min(lacking, compared) if compared > 0 else lacking
            count = min(-(-wanted // STARTS_A_SCENE), len(seeds) - begun)
            yield [SceneJob(replace(job, seed=seed), self.seed, rules) for seed in seeds[begun : begun + count]]
            begun += count
        if lacking > 0:
            raise InputError(
                f"{begun} scenes do not give {self.starts} starts of each kind: the network does its subtasks too "
                "seldom, choose less --starts"
            )

    def _runs(self, job: Job, seeds: list[int], store: RowStore, pool: Pool) -> list["RunRow"]:
        """The disturbed runs."""
        from tqdm import tqdm

        jobs = [
            replace(job, seed=seed, kind="AB"[i % 2], until="as_paper") for i, seed in enumerate(seeds[: self.runs])
        ]
        missing = [given for given in jobs if f"run {given.seed}" not in store.rows]
        known = len(jobs) - len(missing)
        with tqdm(total=len(jobs), initial=known, desc="disturbed", unit="run", disable=None) as bar:
            for given, found in pool.run(run_disturbed, missing):
                store.add(f"run {given.seed}", asdict(found))
                bar.update()
        return [store.read(f"run {given.seed}", partial(of_plain, RunRow)) for given in jobs]


def counts(scenes: list[list["Row"]], rule: str) -> list[int]:
    """How many starts of each of KINDS there are in `scenes` under `rule`."""
    kinds = Counter(row.kind for scene in scenes for row in scene if row.rule == rule)
    return [kinds[kind] for kind in KINDS]


@dataclass(frozen=True)
class SceneJob:
    """The starts of one scene."""

    job: Job
    seed: int  # of the starts
    rules: tuple[str, ...]  # of RESUMPTIONS

    @property
    def key(self) -> str:
        """In the store."""
        return f"scene {self.job.seed} {' '.join(self.rules)}"


def run_scene(given: SceneJob) -> list[Row]:
    """In a worker: the starts of a scene; none of a kind whose subtask fails undisturbed."""
    job = given.job
    # One diagram for both rules: the one without the reset has it switched off in its Context.
    world = replace(job.world, resumption="reset")

    def make() -> Resumptions:
        rollout, controller = build_rollout(world, job.encoder, job.controller), job.controller
        return Resumptions(rollout, stored_calibration(controller.detector, rollout.policy, controller.policy.parent))

    system = kept_in_thread(("resumptions", repr(world), job.controller), make)
    sampler = kept_in_thread(("sampler", repr(world)), lambda: EpisodeSampler(world))
    policy, period = system.rollout.policy, world.timing.period
    points, monitor = system.switching_points(sampler.sample(job.seed, "none", rnn=policy.name))
    by_subtask = {point.subtask: point for point in points}
    limit, found = followed_ticks(period), list[Row]()
    for number, (kind, (subtask, _)) in enumerate(KINDS.items()):
        point = by_subtask.get(subtask)
        rng = np.random.default_rng([given.seed, job.seed, number])
        for i in range(STARTS_A_SCENE if point is not None else 0):
            assert point is not None
            start = Start.drawn(kind, point, world, policy, rng)
            for rule in given.rules:
                reset = rule == "reset"
                way = system.way_home(start.offset)
                foretold = time_to_resume(policy, start.memory, way, system.gain, limit, reset)
                finish = round(FINISH_SECONDS / period) if i == 0 and rule == job.world.resumption else 0
                resumed, done = system.resume(point, start, monitor, reset=reset, limit=limit, finish=finish)
                found.append(Row(job.seed, rule, kind, start.left, foretold, resumed, done))
    return found


def run_disturbed(job: Job) -> RunRow:
    """In a worker: a disturbed run, and T of where its arm came home."""
    from models.inference import Policy

    outcome, record = run_episode(job)
    active = np.flatnonzero(record.active > 0.5)
    if outcome.return_s is None or not len(active):
        return RunRow.none()
    policy = kept_in_thread(("policy", job.controller.policy), lambda: Policy(job.controller.policy))
    period, limit = job.world.timing.period, followed_ticks(job.world.timing.period)
    home = int(active[-1]) + 1 + round(outcome.return_s / period)
    # What the network held at the tick: of the tick before, which it stepped, since the arm was not at home yet.
    before = home - 1
    y, hidden, recalled = policy.step(record.network_input[before], record.hidden_state[before - 1])
    memory = Memory(hidden, np.clip(y, -1.0, 1.0), recalled)
    rows = np.array([policy.scaling.scale(record.posture[home - n])[:ARM_JOINTS] for n in range(policy.horizon + 2)])
    gain = kept_in_thread(("gain", repr(job.world)), lambda: BoxGauge.of(job.world).gain)
    foretold = time_to_resume(policy, memory, rows, gain, limit, job.world.resumption == "reset")
    resumed = None if outcome.resume_s is None else round(outcome.resume_s / period)
    return RunRow(True, foretold, resumed)


def worst_ticks(policy, world: World) -> int | None:
    """T of a network that starts anew where every joint is as far off as can be at home: none at home takes longer.

    The recall's errors are sums of squares of the joints' deviations. None: more than the ticks that are followed.
    """
    gain, limit = BoxGauge.of(world).gain, followed_ticks(world.timing.period)
    rows = way_home(policy, np.full(ARM_JOINTS, HOME_TOLERANCE), gain)
    far_off = np.ones((policy.horizon, policy.posture_size))
    elsewhere = Memory(np.zeros(policy.state_size), np.ones(policy.posture_size), far_off)
    return time_to_resume(policy, elsewhere, rows, gain, limit, reset=True)
