"""Long runs, twice: an hour of disturbances in one process and one Context; each fault beside what people do; and
thousands of episodes in one worker.

    python tests/campaigns/soak.py --seed 0

Whatever a person's hands can do (hold, move, pull, rob, dial), every fault of the camera and late steps are drawn from
the seed, one after the other, without end. The faults of the bench are built into a diagram, one in each: they have a
thirtieth of the time each, with a severity from the seed, while people go on. Started again with the same --out, it
runs the parts that are missing.
Exit code 0: all that is asked for held; 1: something did not; 2: bad input.
"""

import dataclasses
import hashlib
import multiprocessing
import os
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partialmethod
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import tyro
from tqdm import tqdm

from models.checks import LARGEST_SEED, require_numbers
from models.command_line import run
from models.errors import InputError
from tests.campaigns.soak_verdict import judged

GAP = (3, 55)  # ticks from one disturbance to the next: more than 1,000 in an hour
LENGTH = (5, 45)  # ticks that one lasts
LEAST_TICKS, FAR = 300, 9.0  # of a fault's run; m, from the goal: wherever the hand is
SHORT = 1.0  # s of a short episode
SAMPLES = 40  # of the memory in the sweep
SHOWN = 5  # of what was found, in words
ROUNDING = 1e-9  # share of a limit


@dataclass
class SoakArguments:
    """What is run, and where its rows go."""

    seed: int = 0
    minutes: int = 60  # simulated, of each of two runs that must be the same
    count: int = 2000  # short episodes in one worker
    out: Path = Path("outputs/campaigns/soak")


def memory() -> float:
    """MB of this process that are in the machine's memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


class Chance:
    """Draws what happens to the arm, and when; tells the hands."""

    def __init__(self, seed: int, rollout, sampler, gamma: float):
        """`sampler`: an EpisodeSampler; `gamma`: the detector's own."""
        import numpy as np

        self._rng, self._rollout, self._hands = np.random.default_rng(seed), rollout, rollout.hands
        self._sampler, self._gamma, self._next = sampler, gamma, 20
        self._ends: list[tuple[int, Callable[[Any, int], None]]] = []
        self.done: Counter[str] = Counter()
        self._kinds = {
            "held": self._hold, "moved": self._move, "pulled": self._pull, "robbed": self._put, "dialled": self._dial,
            "late": self._delay, "covered": self._fault, "darkened": self._fault, "frozen": self._fault,
        }  # fmt: skip

    def before(self, k: int) -> None:
        """What is to happen from tick `k` on, which has not begun."""
        root = self._rollout.simulator.get_mutable_context()
        for end in [end for end in self._ends if end[0] <= k]:
            self._ends.remove(end)
            end[1](root, k)
        if k < self._next:
            return
        self._next = k + int(self._rng.integers(*GAP))
        kind = str(self._rng.choice(list(self._kinds)))
        self._kinds[kind](root, k, kind)
        self.done[kind] += 1

    def _later(self, k: int, what: Callable[[Any, int], None]) -> None:
        self._ends.append((k + int(self._rng.integers(*LENGTH)), what))

    def _hold(self, root, k: int, kind: str) -> None:
        self._hands.hold(root, k, True)
        self._later(k, lambda root, k: self._hands.hold(root, k, False))

    def _move(self, root, k: int, kind: str) -> None:
        posture, cans = (self._rollout.judged(name) for name in ("measured_posture", "can_poses"))
        try:
            target = self._sampler.pushed_away(self._rng, posture, cans)
        except InputError:  # no way is free: it is stopped
            self._hold(root, k, kind)
            return
        self._hands.move(root, k, target)

    def _pull(self, root, k: int, kind: str) -> None:
        import numpy as np

        from diagrams.world.hands_schedule import LARGEST_FORCE

        self._hands.pull(root, k, self._rng.uniform(-LARGEST_FORCE, LARGEST_FORCE, 3))
        self._later(k, lambda root, k: self._hands.pull(root, k, np.zeros(3)))

    def _put(self, root, k: int, kind: str) -> None:
        self._hands.put_can(root, k, self._rng.uniform(*self._rollout.world.grid.bounds))

    def _dial(self, root, k: int, kind: str) -> None:
        self._hands.set_gamma(root, k, self._gamma * float(10.0 ** self._rng.uniform(-0.5, 1.0)))
        self._later(k, lambda root, k: self._hands.set_gamma(root, k, self._gamma))

    def _delay(self, root, k: int, kind: str) -> None:
        self._hands.delay(root, k, float(self._rng.uniform()))
        self._later(k, lambda root, k: self._hands.delay(root, k, 0.0))

    def _fault(self, root, k: int, kind: str) -> None:
        self._hands.fault(root, k, kind)
        self._later(k, lambda root, k: self._hands.fault(root, k, "clear"))


class Limits:
    """Looks at each tick whether all is finite and within its limits."""

    def __init__(self, rollout):
        import numpy as np

        from diagrams.world.station import controller_limits

        self._rollout, plant = rollout, rollout.station.plant
        self._lower, self._upper, _ = controller_limits(rollout.station)
        self._plant, self._effort = plant, plant.get_net_actuation_output_port()
        actuators = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
        self._most = np.array([actuator.effort_limit() for actuator in actuators])
        self.found: dict[str, list[str]] = {"finite": [], "command": [], "effort": []}

    def see(self, k: int, values: dict) -> None:
        """`values`: of tick `k`, arrays by name, those of RunLog.latest among them."""
        import numpy as np

        from diagrams.world.requirements import SIGNALS

        for name, value in values.items():
            if not np.isfinite(value).all():
                self.found["finite"].append(f"tick {k}: {name} is {value}")
        row = dict(zip(SIGNALS, values["signals"], strict=True))
        for name in ("position_margin", "speed_margin"):
            if row[name] < -ROUNDING:
                self.found["command"].append(f"tick {k}: {name} is {row[name]:g}")
        command = values["desired_posture"]
        if np.any(command < self._lower - ROUNDING) or np.any(command > self._upper + ROUNDING):
            self.found["command"].append(f"tick {k}: the command is {command}")
        root = self._rollout.simulator.get_context()
        effort = self._effort.Eval(self._plant.GetMyContextFromRoot(root))
        if not np.all(np.abs(effort) <= self._most * (1.0 + ROUNDING)):
            self.found["effort"].append(f"tick {k}: the efforts are {effort}, their limits {self._most}")


def long_run(arguments: SoakArguments, fault: str | None = None) -> dict[str, Any]:
    """A scene of the shipped LSTM that goes on and on, see `goes_on`; with `fault` for a thirtieth of the time."""
    import numpy as np

    from diagrams.episodes.calibration import RECALL, Controller, policy_file, stored_calibration
    from diagrams.episodes.runner import build_rollout
    from diagrams.episodes.sampling import EpisodeSampler
    from diagrams.world.configuration import World
    from diagrams.world.names import ENCODER, WEIGHTS

    world = World()
    network = Controller(policy_file(WEIGHTS, "lstm"))
    rollout = build_rollout(world, WEIGHTS / ENCODER, network, hands=True, fault=fault)
    calibration = stored_calibration(RECALL, rollout.policy, WEIGHTS)
    sampler, ticks = EpisodeSampler(world), round(60.0 * arguments.minutes / world.timing.period)
    episode = sampler.sample(arguments.seed, "none")
    if fault is not None:
        ticks = max(ticks // 30, LEAST_TICKS)
        severity = 1.0 - float(np.random.default_rng([arguments.seed, *fault.encode()]).uniform())
        episode = sampler.sample(arguments.seed, fault, severity=severity)
        # It begins at once: near the goal nobody knows when the arm will be, with people about.
        episode = dataclasses.replace(episode, disturbance=dataclasses.replace(episode.disturbance, level=FAR))
    rollout.prepare(episode, calibration)
    chance = Chance(arguments.seed, rollout, sampler, calibration.gamma)
    return goes_on(rollout, chance, ticks)


def each_fault(arguments: SoakArguments, kinds: tuple[str, ...] = ()) -> dict[str, Any]:
    """The `long_run` of each fault of the registry, or of `kinds`: their rows by kind."""
    from diagrams.world.faults.registry import FAULTS

    chosen = tqdm(kinds or tuple(FAULTS), unit="fault", disable=None)
    return {"faults": {kind: long_run(arguments, kind) for kind in chosen}}


def goes_on(rollout, chance: Chance, ticks: int) -> dict[str, Any]:
    """`ticks` in the one Context that `rollout` has, with what `chance` draws: a row of plain types."""
    import numpy as np

    limits, period, root = Limits(rollout), rollout.world.timing.period, rollout.simulator.get_mutable_context()
    bits, measured, seconds, diverged, picked, acted = hashlib.sha256(), [], [], None, 0, 0
    a_minute = round(60.0 / period)
    for k in tqdm(range(ticks), unit="tick", disable=None, mininterval=1.0, leave=False):
        began = time.perf_counter()
        chance.before(k)
        if not rollout.advance((k + 0.5) * period):
            diverged = f"tick {k}: the simulation diverged"
            break
        seconds.append(time.perf_counter() - began)
        names = ("measured_posture", "alpha", "active", "can_poses", "state")
        values = rollout.log.latest(root) | {name: rollout.judged(name) for name in names}
        limits.see(k, values)
        for value in values.values():
            bits.update(value.tobytes())
        picked += bool(values["can_poses"][6] > 0.1)
        acted += bool(rollout.judged("acting")[0])
        if (k + 1) % a_minute == 0:
            measured.append(memory())
    return {
        "ticks": len(seconds), "digest": bits.hexdigest(), "disturbances": dict(chance.done), "megabytes": measured,
        "found": {name: [len(found), *found[:SHOWN]] for name, found in limits.found.items()}, "diverged": diverged,
        "p99_ms": 1e3 * float(np.quantile(seconds, 0.99)), "ticks_picked": picked,
        "ticks_acted": acted,
    }  # fmt: skip


def short_episode(task: Any) -> tuple[str | None, float]:
    """In a worker: the error of the sweep's `task`, ended after SHORT s; memory of the worker then, MB."""
    from diagrams.episodes.rollout import Rollout
    from diagrams.sweeps.task import run_task
    from diagrams.world.names import WEIGHTS

    if not isinstance(vars(Rollout)["run"], partialmethod):
        Rollout.run = partialmethod(Rollout.run, time_limit=SHORT)  # type: ignore[assignment]
    return run_task(WEIGHTS, task)["error"], memory()


def many_episodes(arguments: SoakArguments) -> dict[str, Any]:
    """Episodes of SHORT s one after the other, in the one worker of a sweep's pool: a row of plain types."""
    from diagrams.episodes.pool import Pool
    from diagrams.sweeps.plan import SweepArguments, plan
    from diagrams.world.configuration import World

    kinds = ["none", "A", "B"]
    asked = SweepArguments(episodes=-(-arguments.count // len(kinds)), seed=arguments.seed, purpose="validation",
                           disturbance=kinds, workers=1)  # fmt: skip
    tasks = plan(asked, World())[0][: arguments.count]
    measured, errors = [], []
    with Pool(1) as pool, tqdm(total=len(tasks), unit="episode", disable=None, mininterval=1.0) as bar:
        for number, (task, (error, megabytes)) in enumerate(pool.run(short_episode, tasks), 1):
            bar.update()
            if error:
                errors.append(f"{task.key}: {error}")
            if number * SAMPLES // len(tasks) > (number - 1) * SAMPLES // len(tasks):
                measured.append(megabytes)
    return {"episodes": len(tasks), "megabytes": measured, "errors": [len(errors), *errors[:SHOWN]]}


PARTS: dict[str, Callable[[SoakArguments], dict[str, Any]]] = {
    "first run": long_run, "second run": long_run, "faults": each_fault, "faults again": each_fault,
    "sweep": many_episodes,
}  # fmt: skip


def in_a_process(part: Callable[[SoakArguments], dict[str, Any]], arguments: SoakArguments) -> dict[str, Any]:
    """The row of `part`, of a process of its own; one with `error` where it raised or died."""
    context = multiprocessing.get_context("fork")  # nothing with threads is loaded yet
    receive, send = context.Pipe(duplex=False)

    def work() -> None:
        began = time.perf_counter()
        try:
            row = part(arguments)
        except BaseException:
            row = {"error": traceback.format_exc()}
        send.send(row | {"seconds": time.perf_counter() - began})

    process = context.Process(target=work)
    process.start()
    send.close()
    try:
        row = receive.recv()
    except EOFError:
        row = {}
    process.join()
    return row or {"error": f"its process ended with {process.exitcode}"}


def main(arguments: SoakArguments) -> int:
    """Runs what is missing; returns the exit code."""
    require_numbers(arguments, {"seed": (0, LARGEST_SEED), "minutes": (1, 10_000), "count": (SAMPLES, 10**6)})
    from diagrams.episodes.fingerprint import code_hash
    from diagrams.episodes.store import RowStore

    identity = {name: value for name, value in dataclasses.asdict(arguments).items() if name != "out"}
    with RowStore(
        arguments.out / "soak.jsonl",
        identity | {"code": code_hash("tests/campaigns/soak.py")},
    ) as store:
        for name, part in PARTS.items():
            if name not in store.rows or "error" in store.rows[name]:
                print(f"{name} ...", flush=True)
                row = in_a_process(part, arguments)
                if "error" in row:
                    print(row["error"], file=sys.stderr)
                store.add(name, row)
        held = judged(arguments.minutes, {name: store.rows[name] for name in PARTS})
        for name in PARTS:
            row = store.rows[name]
            a_tick = f", 99 % of the ticks within {row['p99_ms']:.1f} ms" if "p99_ms" in row else ""
            print(f"{name}: {row.get('seconds', 0.0):.0f} s{a_tick}")
    for what, (good, words) in held.items():
        print(f"{'held' if good else 'NOT HELD'}: {what} ({words})")
    print(f"{sum(good for good, _ in held.values())} of {len(held)} held")
    return 0 if all(good for good, _ in held.values()) else 1


def parse(words: list[str] | None = None) -> SoakArguments:
    """The command line."""
    return tyro.cli(SoakArguments, args=words, description=__doc__)


if __name__ == "__main__":
    run(main, parse)
