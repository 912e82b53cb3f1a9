"""Falsification: the smallest perturbation that defeats the switched controller, as scenario files that replay it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import ClassVar

from diagrams.episodes.calibration import Controller
from diagrams.episodes.episode import Episode, Outcome
from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.pool import MOST_WORKERS, Pool
from diagrams.episodes.record import Record, record_hash
from diagrams.episodes.runner import Job, run_episode
from diagrams.episodes.sampling import SEED_BLOCKS, SEEDS_APART, EpisodeSampler, episode_seeds
from diagrams.episodes.store import RowStore
from diagrams.episodes.switching import DEFEATS
from diagrams.hybrid.common import NetworkArguments
from diagrams.hybrid.perturbations import FORMS, Perturbation, PerturbationSpace
from diagrams.hybrid.search import Trial, search_all
from diagrams.world.configuration import World
from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.names import WEIGHTS
from diagrams.world.scenario import Scenario, load_scenario, save_scenario
from models.checks import Range
from models.errors import InputError


@dataclass
class Falsify(NetworkArguments):
    """The smallest disturbance that defeats the switched controller, by three samplers with the same budget."""

    trials: int = 100  # simulated, a sampler; with more of them a search goes on from what is in --out
    scenes: int = 4  # validation scenes among which it chooses
    workers: int = 2  # processes; 0: this one

    NAME: ClassVar[str] = "falsify"
    RANGES: ClassVar[dict[str, Range]] = {
        "seed": (0, SEED_BLOCKS - 1), "trials": (1, 10**6), "scenes": (1, SEEDS_APART), "workers": (0, MOST_WORKERS),
    }  # fmt: skip

    def run(self) -> int:
        """Searches, and replays each sampler's smallest counterexample; returns 0 if all give the same bits, else 1."""
        import cmaes  # noqa: F401 - absent, it is named before anything is run
        import optuna  # noqa: F401

        from diagrams.drawing.falsification import save_search

        world, (encoder, policy, gamma) = self.loaded_world(), self.calibrated()
        sampler = EpisodeSampler(world)
        seeds = episode_seeds("validation", self.seed, self.scenes)
        scenes = [sampler.sample(seed, "none", rnn=policy.name) for seed in seeds]
        chosen = {"seed": self.seed, "scenes": self.scenes, "weights": policy.hash, "encoder": encoder.hash}
        identity = fingerprint(world, "diagrams/hybrid", **chosen)
        with RowStore(self.out / "falsify_trials.jsonl", identity) as store, Pool(self.workers) as pool:

            def simulate(episodes: Sequence[Episode]) -> list[tuple[Outcome, Record]]:
                controller = Controller(self.policy_path)
                jobs = [Job(world, self.encoder_path, controller, episode=episode) for episode in episodes]
                results = {id(job): result for job, result in pool.run(run_episode, jobs)}
                return [results[id(job)] for job in jobs]

            def run_trial(perturbation: Perturbation) -> Trial:
                episode = replace(scenes[perturbation.scene], disturbance=perturbation.disturbance)
                return Trial.of(perturbation, *simulate([episode])[0], gamma)

            print(f"the undisturbed runs of {len(scenes)} scenes ...", flush=True)
            nominal = simulate(scenes)
            for scene, (outcome, _) in zip(scenes, nominal, strict=True):
                if outcome.switched:
                    raise InputError(
                        f"the undisturbed run of the scene {scene.seed} already switches: "
                        "choose another --seed or fewer --scenes"
                    )
            space = PerturbationSpace(world, scenes, [record for _, record in nominal])
            keep = partial(self._keep, world, scenes, policy.hash)
            found = search_all(space.propose, run_trial, self.trials, self.seed, store, on_trial=keep)
            result = report(found, scenes)
            # The smallest of each sampler again, from its file.
            cases = {case["sampler"]: case for case in reversed(result["counterexamples"])}
            files = [self.out / case["file"] for case in cases.values()]
            again = simulate([sampler.episode(load_scenario(file)) for file in files])
        replayed = {
            name: {"file": case["file"], "same_failure": outcome.switch_failure == case["failure"],
                   "same_bits": record_hash(record) == case["record_hash"]}
            for (name, case), (outcome, record) in zip(cases.items(), again, strict=True)
        }  # fmt: skip
        undisturbed = [outcome.success for outcome, _ in nominal]
        made_with = {"fingerprint": identity, "policy": policy.hash, "encoder_hash": encoder.hash}
        self.write(made_with | result | {"undisturbed_success": undisturbed, "replayed": replayed})
        save_search(result["all_trials"], self.out / "falsify.png")
        for name in found:
            print(words(name, result))
        return 0 if all(case["same_bits"] for case in replayed.values()) else 1

    def _keep(self, world: World, scenes: list[Episode], weights: str, name: str, number: int, trial: Trial) -> None:
        """Writes a counterexample at once: a search takes long; `weights`: hash of the policy."""
        if trial.failure is None:
            return
        perturbation, file = trial.perturbation, file_name(name, number)
        scenario = scenario_of(world, scenes[perturbation.scene], self.rnn, perturbation.disturbance)
        elsewhere = "" if self.weights == WEIGHTS else " --weights DIR"
        comments = [
            f"{trial.failure}: {perturbation.form}, {trial.moved_deg:.1f} deg, {perturbation.ticks} ticks, "
            f"in subtask {perturbation.disturbance.subtask}",
            f"{self.policy_path.name} with the hash {weights[:16]}; record {trial.record_hash[:16]}",
            f"python diagrams/pick_place.py --scenario {file}{elsewhere}",
        ]
        save_scenario(self.out / file, scenario, comments)


def file_name(sampler: str, number: int) -> str:
    """Of the scenario file of a counterexample; `number`: of the trial, from 0."""
    return f"{sampler}-{number + 1}.yaml"


def scenario_of(world: World, scene: Episode, rnn: str, disturbance: DisturbanceSpec) -> Scenario:
    """The scenario that gives the scene with this disturbance in full; `rnn`: the network as it was asked for."""
    can = [float(v) for v in scene.can_xy]
    return Scenario(rnn, scene.detector, scene.seed, can, scene.vacant, disturbance, world)


def report(found: dict[str, list[Trial]], scenes: list[Episode]) -> dict:
    """Plain types: the counterexamples, smallest first; what each sampler reached; all trials."""
    all_trials = {name: [_plain(name, n, t, scenes) for n, t in enumerate(trials)] for name, trials in found.items()}
    cases = {name: [row for row in rows if row["failure"] is not None] for name, rows in all_trials.items()}
    counterexamples = [case for rows in cases.values() for case in rows]

    def count(rows: list[dict], entry: str, values: Sequence[str]) -> dict[str, int]:
        return {value: sum(row[entry] == value for row in rows) for value in values}

    return {
        "trials": {name: len(rows) for name, rows in all_trials.items()},
        "trials_to_first": {name: rows[0]["trial"] if rows else None for name, rows in cases.items()},
        "smallest_magnitude": {
            name: min((row["magnitude"] for row in rows), default=None) for name, rows in cases.items()
        },
        "failures": {name: count(rows, "failure", DEFEATS) for name, rows in cases.items()},
        "forms": {name: count(rows, "form", FORMS) for name, rows in all_trials.items()},
        "counterexamples": sorted(counterexamples, key=lambda case: (case["magnitude"], case["file"])),
        "all_trials": all_trials,
    }


def words(name: str, found: dict) -> str:
    """What the sampler `name` reached, by the report `found`, in words."""
    first, trials, smallest = (found[key][name] for key in ("trials_to_first", "trials", "smallest_magnitude"))
    if first is None:
        return f"{name}: no counterexample in {trials} trials"
    failures = ", ".join(f"{count} {failure}" for failure, count in found["failures"][name].items() if count)
    return (
        f"{name}: first counterexample after {first} of {trials} trials, smallest magnitude {smallest:.3f}; {failures}"
    )


def _plain(name: str, number: int, trial: Trial, scenes: list[Episode]) -> dict:
    case = trial.perturbation
    return asdict(trial) | {
        "sampler": name, "trial": number + 1, "file": None if trial.failure is None else file_name(name, number),
        "scene": scenes[case.scene].seed, "form": case.form, "length_ticks": case.ticks, "magnitude": case.magnitude,
    }  # fmt: skip
