"""Requirements: our values of random formulas beside RTAMT's, and what they say of episodes beside the scoring.

    python tests/campaigns/stl.py --seed 0 --count 1000 --episodes 12

Case i is a random formula on a random run. Its value by systems/signal_logic.py is to be RTAMT's to 1e-9 at each tick;
and of another one, of the past, what the diagram's monitor makes of it tick by tick is to be the same bits. An episode
is one of the shipped LSTM; what diagrams/world/requirements.stl says of it is to be what the scoring says; so of each
record that --records names. Started again with the same --out, it runs the cases that are missing.
Exit code 0: all agree; 1: some do not; 2: bad input.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from diagrams.episodes.switching import SWITCHING_FAILURES
from diagrams.world.requirements import broken
from models.checks import require_numbers
from models.command_line import run
from models.errors import InputError
from systems.signal_logic import robustness
from systems.signal_logic_online import OnlineRobustness
from systems.signal_logic_text import parse_requirements

SIGNALS = ("a", "b", "c")
LONGEST = 12  # ticks of an interval
DEEPEST = 4  # operators in each other
TOLERANCE = 1e-9
KINDS = ("none", "A", "B")  # of the episodes, in turn
# Of the scoring, in its order, by the requirement that says the same.
FAILURES = dict(
    zip(("no_false_switch", "notices", "returns", "resumes", "no_later_switch"), SWITCHING_FAILURES, strict=True)
)


@dataclass
class StlArguments:
    """How many cases, and where their rows go."""

    seed: int = 0
    count: int = 1000  # random formulas
    episodes: int = 12  # of the shipped LSTM, validation scenes
    # Of pick_place.py --record or sweep.py --keep-records; or folders.
    records: list[Path] = field(default_factory=list)
    out: Path = Path("outputs/campaigns/stl")


def random_formula(rng: np.random.Generator, depth: int, past: bool) -> str:
    """A formula in the words of systems/signal_logic_text.py, `depth` operators deep at most; `past`: of the past."""
    if depth == 0 or rng.uniform() < 0.1:
        sign = rng.choice(["<", "<=", ">", ">="])
        return f"{_sum(rng)} {sign} {_sum(rng)}"

    def inside() -> str:
        return f"({random_formula(rng, depth - 1, past)})"

    temporal = ["once", "historically", "since"] + ([] if past else ["always", "eventually", "until"])
    word = rng.choice(["not", "and", "or", "implies", *temporal, *temporal])
    first = int(rng.integers(0, LONGEST))
    interval = "" if rng.uniform() < 0.3 else f"[{first}:{int(rng.integers(first, LONGEST + 1))} tick]"
    if word == "not":
        return f"not {inside()}"
    if word in ("and", "or", "implies"):
        return f"{inside()} {word} {inside()}"
    if word in ("since", "until"):
        return f"{inside()} {word}{interval} {inside()}"
    return f"{word}{interval} {inside()}"


def random_requirement(rng: np.random.Generator, depth: int) -> str:
    """One that can be watched while it runs: of always and eventually, of formulas of the past."""
    parts = [f"{rng.choice(['always', 'eventually'])} ({random_formula(rng, depth, past=True)})" for _ in range(2)]
    return f"not ({parts[0]}) {rng.choice(['and', 'or', 'implies'])} ({parts[1]})"


def _sum(rng: np.random.Generator) -> str:
    names = rng.choice(SIGNALS, size=3)
    terms = [f"{rng.uniform(0.1, 3.0):.3f} * {names[0]}", f"abs({names[1]} - {rng.uniform():.2f})",
             f"{rng.uniform(0.0, 1.0):.3f}", str(names[2])]  # fmt: skip
    chosen = [str(term) for term in rng.choice(terms, size=rng.integers(1, 4), replace=False)]
    # A minus before the last term alone: RTAMT takes a - b + c for a - (b + c).
    return " + ".join(chosen[:-1]) + f" {rng.choice(['+', '-'])} " * (len(chosen) > 1) + chosen[-1]


def random_run(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """2 to 40 ticks of each signal (RTAMT takes no fewer); some values come again."""
    n = int(rng.integers(2, 41))
    return {name: np.where(rng.uniform(size=n) < 0.3, 0.5, rng.normal(size=n)) for name in SIGNALS}


def by_rtamt(formula: str, signals: dict[str, np.ndarray]) -> np.ndarray:
    """(n,) what RTAMT makes of it."""
    import rtamt

    specification = rtamt.StlDiscreteTimeSpecification()
    for name in SIGNALS:
        specification.declare_var(name, "float")
    # Its unit is a sampling period; without the brackets its parser calls some sums ambiguous.
    specification.spec = f"({formula.replace(' tick]', ']')})"
    specification.parse()
    n = len(next(iter(signals.values())))
    data = {"time": list(range(n))} | {name: values.tolist() for name, values in signals.items()}
    return np.array([value for _, value in specification.evaluate(data)])


def formula_agrees(seed: int, number: int) -> str | None:
    """What is wrong with case `number`; None: nothing."""
    rng = np.random.default_rng((seed, number))
    depth = int(rng.integers(1, DEEPEST + 1))
    text, signals = random_formula(rng, depth, past=False), random_run(rng)
    own = robustness(parse_requirements(f"require it: {text}", SIGNALS, 1.0, "the formula")["it"], signals)
    theirs = by_rtamt(text, signals)
    with np.errstate(invalid="ignore"):  # infinity less itself
        wrong = np.flatnonzero((own != theirs) & ~(np.abs(own - theirs) <= TOLERANCE))
    if len(wrong):
        return f"{text} is {own[wrong[0]]} in tick {wrong[0]}, by RTAMT {theirs[wrong[0]]}"
    text, signals = random_requirement(rng, depth - 1), random_run(rng)
    formulas = parse_requirements(f"require it: {text}", SIGNALS, 1.0, "the formula")
    online = OnlineRobustness(formulas, SIGNALS)
    memory, n = online.initial, len(signals[SIGNALS[0]])
    for k in range(n):
        found, memory = online.step(memory, np.array([signals[name][k] for name in SIGNALS]))
        whole = robustness(formulas["it"], {name: values[: k + 1] for name, values in signals.items()})[0]
        if found[0] != whole:
            return f"{text} is {whole} after tick {k}, tick by tick {found[0]}"
    return None


def failure_of(signals: np.ndarray, period: float) -> str | None:
    """The failure of the switching that the requirements say; `signals`: of a Record."""
    found = broken(signals, period)
    return next((failure for name, failure in FAILURES.items() if name in found), None)


def record_agrees(signals: np.ndarray, time: np.ndarray, outcome: dict) -> str | None:
    """What is wrong in a record with that outcome; None: nothing, or the switching was not judged."""
    from diagrams.episodes.episode import DIVERGED

    said = outcome["switch_failure"]
    judged = outcome["false_switches"] is not None and (outcome["switch_success"] is not None or outcome["void"])
    if not judged or said == DIVERGED:
        return None
    found = failure_of(signals, float(time[1] - time[0]) if len(time) > 1 else 1.0)
    return None if found == said else f"by the requirements {found}, by the scoring {said}"


def episode_agrees(scene: int, kind: str) -> str | None:
    """What is wrong in an episode of the shipped LSTM; None: nothing."""
    from diagrams.episodes.calibration import Controller, policy_file
    from diagrams.episodes.runner import Job, run_episode
    from diagrams.world.configuration import World
    from diagrams.world.names import ENCODER, WEIGHTS

    job = Job(World(), WEIGHTS / ENCODER, Controller(policy_file(WEIGHTS, "lstm")), scene, kind)
    outcome, record = run_episode(job)
    return record_agrees(record.signals, record.time, outcome.to_dict())


def stored_agrees(path: Path) -> str | None:
    """What is wrong in a record's file; None: nothing."""
    from diagrams.episodes.record import load_record

    record, outcome = load_record(path)
    return record_agrees(record.signals, record.time, outcome)


def main(arguments: StlArguments) -> int:
    """Runs what is missing, and the records; returns the exit code."""
    from diagrams.episodes.fingerprint import code_hash
    from diagrams.episodes.record import find_records
    from diagrams.episodes.sampling import SEED_BLOCKS, SEEDS_APART, episode_seeds
    from diagrams.episodes.store import RowStore

    require_numbers(arguments, {"seed": (0, SEED_BLOCKS - 1), "count": (0, 10**6), "episodes": (0, SEEDS_APART)})
    try:
        import rtamt  # noqa: F401
    except ImportError as error:
        raise InputError(
            f"RTAMT cannot be imported ({error}): pip install -e '.[dev]' with Python 3.11 or 3.12"
        ) from error
    cases: dict[str, Callable[[], str | None]] = {
        f"formula {number}": partial(formula_agrees, arguments.seed, number) for number in range(arguments.count)
    }
    scenes = episode_seeds("validation", arguments.seed, arguments.episodes) if arguments.episodes else []
    for scene, kind in zip(scenes, itertools.cycle(KINDS)):
        cases[f"episode {kind} {scene}"] = partial(episode_agrees, scene, kind)
    records = {str(path): partial(stored_agrees, path) for path in find_records(arguments.records)}
    made_with = {"seed": arguments.seed, "code": code_hash("tests/campaigns/stl.py")}
    with RowStore(arguments.out / "stl.jsonl", made_with) as store:
        missing = {key: case for key, case in cases.items() if key not in store.rows}
        for key, case in tqdm((missing | records).items(), unit="case", disable=None):
            store.add(key, case())
        asked = [*cases, *records]
        wrong = {key: store.rows[key] for key in asked if store.rows[key] is not None}
    for key, words in wrong.items():
        print(f"{key}: {words}")
    print(f"{len(asked) - len(wrong)} of {len(asked)} agree")
    return 1 if wrong else 0


def parse(words: list[str] | None = None) -> StlArguments:
    """The command line."""
    return tyro.cli(StlArguments, args=words, description=__doc__)


if __name__ == "__main__":
    run(main, parse)
