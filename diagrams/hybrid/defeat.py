"""The probability that a disturbance of the stated distribution defeats the switched controller.

The distribution is that of EpisodeSampler, each scene random. The closed loop is deterministic, so all that is random
is the input: splitting.py, over the coordinates of diagrams/episodes/space.py, with the level of severity.py. Brute
force, by the sampler's own seeds, is the check.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, ClassVar, Literal

import numpy as np
from tqdm import tqdm

from diagrams.episodes.calibration import Controller
from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import MOST_WORKERS, Pool
from diagrams.episodes.runner import Job
from diagrams.episodes.sampling import SEED_BLOCKS, SEEDS_APART, EpisodeSampler, episode_seeds
from diagrams.episodes.space import EpisodeSpace
from diagrams.episodes.store import RowStore
from diagrams.episodes.switching import Until
from diagrams.hybrid.common import NetworkArguments
from diagrams.hybrid.defeat_cases import Case, Cases
from diagrams.hybrid.defeat_report import clusters, plain
from diagrams.hybrid.estimates import of_count, of_repetitions
from diagrams.hybrid.falsification import scenario_of
from diagrams.hybrid.severity import DEFEATED
from diagrams.hybrid.splitting import Kernel, Splitting, above_level, require_sizes, split
from diagrams.world.configuration import World
from diagrams.world.names import WEIGHTS
from diagrams.world.scenario import save_scenario
from models.checks import Range
from models.errors import InputError

SCENE_MOVES, BLOCK_MOVES = 0.25, 0.5  # chances that a move changes the scene, and each other block
COMPARED_AT = 1e-2  # probability of the level that is told beside brute force
ALIKE = 3  # branched episodes that are run again from tick 0, a kind


@dataclass
class Defeat(NetworkArguments):
    """The probability that a disturbance defeats the switched controller, by splitting and by brute force."""

    kinds: tuple[str, ...] = ("A", "B")
    population: int = 40  # episodes of a repetition at a time
    kept: float = 0.2  # share of them that stays, a stage of the pilot
    moves: int = 1  # of each, a stage
    rarest: float = 1e-5  # a probability; what is rarer is not looked for
    repetitions: int = 4  # independent, beside the pilot, for the interval
    brute: int = 0  # episodes of brute force, a kind; 0: none
    until: Literal["task", "resumption"] = "task"  # end of a run; resumption: false alarms are no defeats
    branch: bool = True  # begin episodes of a known scene with a clone of its undisturbed ticks
    workers: int = 2  # processes; 0: this one

    NAME: ClassVar[str] = "defeat"
    RANGES: ClassVar[dict[str, Range]] = {
        "rarest": (0.0, 1.0),
        "seed": (0, SEED_BLOCKS - 1), "population": (1, 10**5), "moves": (1, 1000), "repetitions": (2, 1000),
        "brute": (0, SEEDS_APART), "workers": (0, MOST_WORKERS),
    }  # fmt: skip

    def check(self) -> None:
        """Raises InputError also for sizes that make no run, and for kinds that take no arm."""
        super().check()
        require_sizes(self.population, self.kept, self.moves)
        if not self.kinds or len(set(self.kinds)) != len(self.kinds) or not set(self.kinds) <= {"A", "B"}:
            raise InputError(f"--kinds {' '.join(self.kinds)} is no choice of A and B: give one or both of them")
        if self.brute:
            episode_seeds("defeat", self.seed, self.brute)

    def run(self) -> int:
        """Estimates; returns 0 if a clone goes on as the whole episode, and brute force contradicts nothing, else 1.

        It is asked twice a kind: of a defeat, and of one level, see `compared`.
        """
        from diagrams.drawing.defeat import save_defeat

        world, (encoder, policy, gamma) = self.loaded_world(), self.calibrated()
        chosen = {"weights": policy.hash, "encoder": encoder.hash, "branch": self.branch, "until": self.until}
        identity = fingerprint(world, "diagrams/hybrid", **chosen)
        until: Until = "task" if self.until == "task" else "as_paper"
        job = Job(world, self.encoder_path, Controller(self.policy_path), until=until)
        found: dict[str, dict[str, Any]] = {}
        with RowStore(self.out / "defeat_cases.jsonl", identity) as store, Pool(self.workers) as pool:
            cases = Cases(job, gamma, self.branch, store, pool)
            for kind in self.kinds:
                found[kind] = self._of_kind(kind, world, cases, policy.name)
        sizes = {n: getattr(self, n) for n in ("population", "kept", "moves", "rarest", "repetitions", "until")}
        made_with = {"fingerprint": identity, "policy": policy.hash, "encoder_hash": encoder.hash}
        self.write(made_with | sizes | {"kinds": {kind: entry["report"] for kind, entry in found.items()}})
        save_defeat(found, self.out / "defeat.png")
        for kind, entry in found.items():
            print(words(kind, entry["report"]))
        reports = [entry["report"] for entry in found.values()]
        comparisons = [part for entry in reports for part in (entry, compared(entry)) if part is not None]
        apart = any(part["overlap"] is False for part in comparisons)
        return 1 if apart or any(entry["same_bits"]["same"] < entry["same_bits"]["of"] for entry in reports) else 0

    def _of_kind(self, kind: str, world: World, cases: Cases, rnn: str) -> dict[str, Any]:
        space = EpisodeSpace(world, kind, rnn)
        runs, seen, levels = list[Splitting](), list[list[Case | None]](), None
        for number in range(self.repetitions + 1):
            title = f"{kind}, repetition {number} of {self.repetitions}" if number else f"{kind}, pilot"
            climb = Climb(space, cases, title)
            rng = np.random.default_rng([self.seed, "AB".index(kind), number])
            runs.append(climb.run(self.population, self.kept, self.moves, self.rarest, rng, levels))
            seen.append(climb.seen)
            levels = [stage.level for stage in runs[0].stages]
        by_brute = self._by_brute(kind, world, cases, rnn) if self.brute else []
        drawn = [case for entry in seen for case in entry[: self.population] if case is not None] + by_brute
        distinct = list({repr(case.episode): case for entry in seen for case in entry if case is not None}.values())
        everything = {repr(case.episode): case for case in (*distinct, *by_brute)}.values()
        defeats = [case for case in everything if case.level >= DEFEATED]
        branched = [case for case in distinct if case.saved]
        result = report(runs, seen, distinct, by_brute, self.population, self.moves) | {
            "same_bits": {"of": len(branched[:ALIKE]), "same": sum(cases.again(case) for case in branched[:ALIKE])},
            "counterexamples": [plain(case) for case in defeats],
            **clusters(defeats, drawn),
        }
        for stale in self.out.glob(f"defeat-{kind}-*.yaml"):  # of an earlier run, which may have found more
            stale.unlink()
        for number, cluster in enumerate(result["clusters"], start=1):
            case = defeats[cluster["example"]]
            cluster["file"] = f"defeat-{kind}-{number}.yaml"
            scenario = scenario_of(world, case.episode, self.rnn, case.episode.disturbance)
            elsewhere = "" if self.weights == WEIGHTS else " --weights DIR"
            comments = [cluster["words"], f"python diagrams/pick_place.py --scenario {cluster['file']}{elsewhere}"]
            save_scenario(self.out / cluster["file"], scenario, comments)
        return {"report": result, "cases": list(everything)}

    def _by_brute(self, kind: str, world: World, cases: Cases, rnn: str) -> list[Case]:
        sampler, seeds = EpisodeSampler(world), episode_seeds("defeat", self.seed, self.brute)
        with tqdm(total=len(seeds), desc=f"{kind}, brute force", unit="episode", disable=None) as bar:
            return cases.run([sampler.sample(seed, kind, rnn=rnn) for seed in seeds], bar)


class Climb:
    """One repetition: from points to the levels of their episodes; `seen`: the case of each evaluation."""

    def __init__(self, space: EpisodeSpace, cases: Cases, title: str):
        self._space, self._cases, self._title = space, cases, title
        self.seen: list[Case | None] = []  # None: no episode

    def run(
        self,
        population: int,
        kept: float,
        moves: int,
        rarest: float,
        rng: np.random.Generator,
        levels: list[float] | None,
    ) -> Splitting:
        """See `split`."""
        blocks = self._space.blocks
        chances = [SCENE_MOVES if name == "scene" else BLOCK_MOVES for name in blocks]
        kernel = Kernel(list(blocks.values()), chances)
        with tqdm(desc=self._title, unit="episode", disable=None) as bar:

            def evaluate(points: np.ndarray) -> np.ndarray:
                episodes = [self._space.episode(point) for point in points]
                run = iter(self._cases.run([episode for episode in episodes if episode is not None], bar))
                new = [None if episode is None else next(run) for episode in episodes]
                self.seen += new
                return np.array([-np.inf if case is None else case.level for case in new])

            return split(
                evaluate, kernel, self._space.size, DEFEATED, population=population, kept=kept, moves=moves, rng=rng,
                levels=levels, rarest=rarest,
                on_stage=lambda stage: bar.set_postfix_str(f"level {stage.level:.3f}"),
            )  # fmt: skip


def report(
    runs: Sequence[Splitting],
    seen: Sequence[Sequence[Case | None]],
    distinct: Sequence[Case],
    brute: Sequence[Case],
    population: int,
    moves: int,
) -> dict[str, Any]:
    """Plain types: the estimates of defeats and of failed tasks, and what they cost.

    Of failed tasks None where the runs end before. `runs`: the pilot first, which only the costs count; `seen`: of each
    run the case of each evaluation; `distinct`: each of them once; `brute`: of brute force;
    `population`: episodes with which each run began; `moves`: of each, a stage.
    """
    repetitions, smallest = runs[1:], [run.smallest for run in runs[1:]]
    drawn = sum(case is not None for cases in seen[1:] for case in cases[:population])
    switching = of_repetitions([run.estimate for run in repetitions], smallest, drawn)
    judged = all(case.task_done is not None for case in distinct)
    task = of_repetitions(_shares(repetitions, seen[1:], _task_failed), smallest, drawn) if judged else None
    by_failure = dict[str, dict[str, Any]]()
    # A false switch, for one, comes before the disturbance, which has no part in it.
    for failure in sorted({str(case.failure) for case in distinct if case.level >= DEFEATED}):
        shares = _shares(repetitions, seen[1:], partial(_failed_as, failure))
        by_failure[failure] = of_repetitions(shares, smallest, drawn).plain()
    found = switching.plain() | {
        "episodes": len(distinct),
        "evaluations": sum(run.evaluations for run in runs),
        "defeats_found": sum(case.level >= DEFEATED for case in distinct),
        "without_episode": sum(case is None for cases in seen for case in cases),
        "ticks": {"all": sum(case.ticks for case in distinct), "saved": sum(case.saved for case in distinct)},
        "repetitions": [
            {"estimate": run.estimate, "extinct": run.extinct, "evaluations": run.evaluations,
             "stages": [asdict(stage) for stage in run.stages]} for run in repetitions
        ],
        "levels": [stage.level for stage in runs[0].stages],
        "above": _above(runs, population, moves, brute),
        "by_failure": by_failure, "task": None if task is None else task.plain(),
        "brute": None, "overlap": None,
    }  # fmt: skip
    if brute:
        counted = of_count(sum(case.level >= DEFEATED for case in brute), len(brute))
        found["brute"] = counted.plain() | {
            "episodes": len(brute), "void": sum(case.void for case in brute), "task": None,
            "share_of_episodes": len(distinct) / len(brute),  # that splitting took
        }  # fmt: skip
        found["overlap"] = switching.overlaps(counted)
        if task is not None:
            tasks = of_count(sum(map(_task_failed, brute)), len(brute))
            found["brute"]["task"], found["task"]["overlap"] = tasks.plain(), task.overlaps(tasks)
    return found


def _above(runs: Sequence[Splitting], population: int, moves: int, brute: Sequence[Case]) -> list[dict[str, Any]]:
    """How probable it is to come beyond each level of the pilot that some repetition passed; see `report`.

    With what it takes to get there, the pilot included, and brute force beside it, which sees levels where it sees no
    defeat. The share is of points, those that make no episode included; of brute force it is of episodes.
    """
    found, repetitions = [], runs[1:]
    drawn, smallest = population * len(repetitions), [run.smallest for run in repetitions]
    for number, level in enumerate(stage.level for stage in runs[0].stages):
        passed = [above_level(run, number) for run in repetitions]
        if not any(passed):
            continue
        # Beyond the first level the points are independent, so that the count is binomial.
        count = round(population * sum(passed))
        by_splitting = of_repetitions(passed, smallest, drawn) if number else of_count(count, drawn)
        evaluations = len(runs) * population * (1 + moves * number)
        entry = {"level": level, "evaluations": evaluations, **by_splitting.plain(), "brute": None, "overlap": None}
        if brute:
            counted = of_count(sum(case.level > level for case in brute), len(brute))
            entry |= {"brute": counted.plain(), "overlap": by_splitting.overlaps(counted)}
        found.append(entry)
    return found


def compared(found: dict[str, Any]) -> dict[str, Any] | None:
    """The level at which splitting is compared with brute force: whose probability by splitting is nearest to 1e-2."""
    entries = [entry for entry in found["above"] if entry["brute"] is not None]
    return min(entries, key=lambda entry: abs(np.log(entry["estimate"] / COMPARED_AT)), default=None)


def _shares(
    runs: Sequence[Splitting], seen: Sequence[Sequence[Case | None]], counts: Callable[[Case], bool]
) -> list[float]:
    """Of each run: how probable it is that a case `counts`."""
    return [
        sum(weight for number, weight in run.weights if (case := cases[number]) is not None and counts(case))
        for run, cases in zip(runs, seen, strict=True)
    ]


def _failed_as(failure: str, case: Case) -> bool:
    return case.failure == failure and case.level >= DEFEATED


def _task_failed(case: Case) -> bool:
    return not case.task_done and not case.void


def words(kind: str, found: dict[str, Any]) -> str:
    """The estimates of a kind, in words."""

    def of(entry: dict[str, Any]) -> str:
        low, high = entry["interval"]
        return f"{entry['estimate']:.2e} [{low:.2e}, {high:.2e}]"

    def task(entry: dict[str, Any]) -> str:
        return "" if entry["task"] is None else f", task failed {of(entry['task'])}"

    ticks = found["ticks"]
    text = (
        f"disturbance {kind}: defeated with probability {of(found)} by {found['episodes']} episodes "
        f"({ticks['saved'] / max(ticks['all'], 1):.0%} of their ticks saved by clones){task(found)}"
    )
    if not found["defeats_found"] and found["above"]:
        text += f"; none was found, and beyond the level {found['above'][-1]['level']:.3f} are {of(found['above'][-1])}"
    if (level := compared(found)) is not None:
        text += (
            f"; beyond the level {level['level']:.3f} {of(level)} by {level['evaluations']} episodes, by brute force "
            f"{of(level['brute'])}; intervals {'overlap' if level['overlap'] else 'are apart'}"
        )
    for failure, entry in found["by_failure"].items():
        text += f"; {failure}: {of(entry)}"
    if found["brute"] is not None:
        text += (
            f"; brute force, {found['brute']['episodes']} episodes: "
            f"{of(found['brute'])}{task(found['brute'])}; intervals {'overlap' if found['overlap'] else 'are apart'}"
        )
    return text
