"""Analyses the switched controller as one hybrid system.

    python diagrams/analysis.py {modes,return,linearize,guard,falsify,states} --out DIR

Each writes DIR/NAME.json and its pictures beside it. Exit code 0: what it checks holds; 1: it does not; 2: bad input.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from diagrams.world.configuration import World
from diagrams.world.names import SPOTS, WEIGHTS
from diagrams.world.scenario import save_scenario
from models.errors import InputError
from models.files.weights import WeightsError
from models.networks import NETWORKS


@dataclass
class Common:
    """What every item takes."""

    out: Path = Path("outputs/analysis")  # folder
    seed: int = 0  # draws whatever is random


@dataclass
class WithNetworks(Common):
    """What the items that run the closed loop take beside it."""

    rnn: str = "lstm"
    weights: Path = field(default_factory=lambda: WEIGHTS)  # folder of the trained networks


@dataclass
class Modes(WithNetworks):
    """The automaton of runs: modes, guard crossings, dwell times, resets; no run shows chatter."""

    record: list[Path] = field(default_factory=list)  # of pick_place.py --log, or folders of them; none: runs --seed
    disturbance: Literal["none", "A", "B"] = "A"  # of the run, where there is no record
    max_crossings: int = 4  # guard crossings in any second that are still no chatter


@dataclass
class Return(WithNetworks):
    """The certificate of mode `return`, and its proof on the full plant."""

    samples: int = 10_000  # postures inside the certified set
    outside: int | None = None  # postures outside; default: a fifth of the samples
    units: Literal["policy", "limits"] = (
        "policy"  # of S: the controller's scaling, or the distances to the joint limits
    )
    workers: int = 2


@dataclass
class Linearize(Common):
    """The switching point as a fixed point of one tick: eigenvalues, and decay predicted and simulated."""

    weights: list[Path] = field(default_factory=lambda: [WEIGHTS / "lstm.safetensors"])  # networks to compare
    encoder: Path = field(default_factory=lambda: WEIGHTS / "cae.safetensors")
    samples: int = 10  # perturbations simulated for each network and subtask
    can: list[float] = field(default_factory=lambda: [0.53, 0.0])  # X Y, m, world
    vacant: str = "left"


@dataclass
class Guard(WithNetworks):
    """The surface alpha = 1/2 over two directions of posture displacement."""

    grid: int = 41  # points a side, odd
    joints: tuple[int, int] = (1, 4)  # the two directions
    reach: float = 20.0  # deg, to either side
    level: float = 0.20  # the moment: the hand is so near to the can, m
    ticks: int = 3  # from the displacement on, over which the largest alpha is taken
    rays: int = 16  # along which points are bisected


@dataclass
class Falsify(WithNetworks):
    """The smallest disturbance that defeats the switched controller, by three samplers with the same budget."""

    trials: int = 40  # simulated, a sampler; with more of them a search goes on from what is in --out
    scenes: int = 4  # validation scenes among which it chooses
    workers: int = 2


@dataclass
class States(WithNetworks):
    """Every state of the hybrid system, and that they are all; and the graph."""


def main(item: Common) -> int:
    """Runs one item; returns the exit code."""
    import torch

    torch.set_num_threads(1)
    _check(item)
    try:
        item.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{item.out} cannot be written ({error.strerror}): choose another --out") from error
    return next(run for kind, run in ITEMS.values() if kind is type(item))(item)


def _check(item: Common) -> None:
    if item.seed < 0:
        raise InputError(f"the seed {item.seed} is negative: choose a whole number from 0 on")
    if isinstance(item, WithNetworks) and item.rnn not in NETWORKS:
        raise InputError(f"there is no rnn '{item.rnn}': choose one of {', '.join(NETWORKS)}")
    least = {
        "samples": 1,
        "outside": 0,
        "trials": 1,
        "scenes": 1,
        "grid": 3,
        "ticks": 1,
        "rays": 1,
        "workers": 1,
        "max_crossings": 0,
    }
    for name, minimum in least.items():
        value = getattr(item, name, None)
        if value is not None and value < minimum:
            raise InputError(f"--{name.replace('_', '-')} {value} is too small: choose {minimum} or more")


def _write(item: Common, name: str, report: dict) -> None:
    text = json.dumps(_plain({"seed": item.seed} | report), indent=1, allow_nan=False)
    (item.out / f"{name}.json").write_text(text + "\n")


def _plain(value: Any) -> Any:
    """`value` with None for every number that is not finite, which JSON has no word for."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _networks(item: WithNetworks):
    from models.inference import Encoder, Policy

    return Encoder(item.weights / "cae.safetensors"), Policy(item.weights / f"{item.rnn}.safetensors")


def _rollout(item: WithNetworks, world: World):
    from diagrams.episodes.rollout import Rollout

    return Rollout(world, *_networks(item))


def run_modes(item: Modes) -> int:
    """See Modes."""
    from diagrams.episodes.record import find_records, load_record, save_record
    from diagrams.hybrid.modes import mode_sequence, report, save_automaton

    world, paths = World(), find_records(item.record)
    if not paths:
        from tqdm import tqdm

        from diagrams.episodes.sampling import EpisodeSampler

        with tqdm(desc="run", unit="tick", leave=False, disable=None) as bar:
            episode = EpisodeSampler(world).sample(item.seed, item.disturbance, rnn=item.rnn)
            outcome, record = _rollout(item, world).run(episode, on_tick=lambda _: bar.update())
        paths = [item.out / f"run-{item.rnn}-{item.disturbance}-{item.seed}.npz"]
        save_record(paths[0], record, outcome)
    runs = [mode_sequence(*load_record(path), path.stem, world.initial_posture) for path in paths]
    found = report(runs, item.max_crossings)
    _write(item, "modes", found)
    save_automaton(runs, item.out / "modes.png")
    print(
        f"{len(runs)} runs, {found['transitions']['task->return']} switches to the LQR; at most "
        f"{found['max_crossings_per_second']} crossings in a second (limit {item.max_crossings})"
    )
    for mode, dwell in found["dwell_seconds"].items():
        if dwell["count"]:
            print(f"dwell in {mode}: {dwell['min']:.1f} to {dwell['max']:.1f} s, median {dwell['median']:.1f} s")
    return 1 if found["zeno_like"] else 0


def run_return(item: Return) -> int:
    """See Return."""
    from diagrams.hybrid.return_certificate import certify, holds, save_certificate
    from diagrams.world.names import ARM_JOINTS
    from diagrams.world.station import PickPlaceStation, controller_limits
    from models.files.weights import load_policy

    world = World()
    if item.units == "policy":
        units = load_policy(item.weights / f"{item.rnn}.safetensors").scaling.half_range[:ARM_JOINTS]
    else:
        lower, upper, _ = (v[:ARM_JOINTS] for v in controller_limits(PickPlaceStation(world, camera=False)))
        home = world.initial_posture[:ARM_JOINTS]
        units = np.minimum(upper - home, home - lower)
    outside = item.samples // 5 if item.outside is None else item.outside
    parts = item.out / "return_parts"
    found, picture = certify(
        world, units, samples=item.samples, outside=outside, seed=item.seed, workers=item.workers, folder=parts
    )
    _write(item, "return", {"units": item.units} | found)
    save_certificate(picture, world, item.out / "return.png")
    shutil.rmtree(parts)  # for a run that is broken off only
    print(
        f"inside: {found['failures_inside']} of {found['samples_inside']} fail to come home; V rises by at most "
        f"{found['max_v_increase']:.2e} (tolerance {found['v_tolerance']:.2e}); V contracts by {found['contraction_rate_measured']:.3f} a tick "
        f"(certified {found['contraction_rate']:.3f})\noutside: {found['failures_outside']} of {outside} fail; "
        f"straight ways home that touch something: {found['collision_share']} inside, {found['collision_share_outside']} outside"
    )
    return 0 if holds(found) else 1


def run_linearize(item: Linearize) -> int:
    """See Linearize."""
    from tqdm import tqdm

    from diagrams.episodes.sampling import EpisodeSampler
    from diagrams.hybrid.switching_point import analyse, save_spectra, subtask_images
    from models.files.weights import file_hash, load_policy
    from models.inference import Encoder

    if len(item.can) != 2 or item.vacant not in SPOTS:
        raise InputError(f"--can takes X and Y, --vacant one of {', '.join(SPOTS)}")
    world, encoder = World(), Encoder(item.encoder)
    EpisodeSampler(world).require_reachable((item.can[0], item.can[1]))
    networks = [(path, load_policy(path)) for path in item.weights]
    for path, stored in networks:
        if stored.encoder_hash != encoder.hash:
            raise InputError(
                f"{path} was trained with another encoder than {item.encoder}: give that one with --encoder"
            )
    images = subtask_images(world, encoder, (item.can[0], item.can[1]), item.vacant)
    cases, pictures = [], []
    jobs = [(path, stored, image) for path, stored in networks for image in images]
    for path, stored, image in tqdm(jobs, desc="linearize", unit="case", disable=None):
        found, picture = analyse(world, stored, image, samples=item.samples, seed=item.seed)
        training = stored.metadata.get("training", {})
        cases.append(
            {"weights": path.name, "hash": file_hash(path), "rnn": stored.rnn.name,
             "state_weight": training.get("state_weight")} | found
        )  # fmt: skip
        pictures.append((f"{path.stem}, subtask {image.subtask}", picture))
        print(
            f"{path.name}, subtask {found['subtask']}: {found['kind']} {found['distance_deg']:.2f} deg from the initial posture, spectral radius "
            f"{found['spectral_radius']:.4f}; factor a tick predicted {found['decay_predicted']:.4f}, simulated {found['decay_measured']:.4f}; "
            f"Jacobian off by {found['jacobian_error']:.1e}",
            flush=True,
        )
    worst = max(cases[: len(images)], key=lambda case: case["spectral_radius"])
    of_worst = {name: worst[name] for name in ("spectral_radius", "decay_predicted", "decay_measured")}
    largest = {name: max(case[name] for case in cases) for name in ("jacobian_error", "decay_error")}
    _write(item, "linearize", of_worst | largest | {"can": item.can, "vacant": item.vacant, "cases": cases})
    save_spectra(pictures, item.out / "linearize.png")
    return 0 if largest["jacobian_error"] <= 1e-5 and largest["decay_error"] <= 0.1 else 1


def run_guard(item: Guard) -> int:
    """See Guard."""
    from tqdm import tqdm

    from diagrams.episodes.sampling import EpisodeSampler
    from diagrams.hybrid.guard import GuardProbe, bisect, holds, report, save_guard, scan
    from diagrams.world.names import ARM_JOINTS

    if item.grid % 2 == 0:
        raise InputError(
            f"--grid {item.grid} is even, so that no displacement would not be on it: choose an odd number"
        )
    if len(set(item.joints)) != 2 or not all(1 <= joint <= ARM_JOINTS for joint in item.joints):
        raise InputError(f"--joints {item.joints} are not two different joints: choose from 1 to {ARM_JOINTS}")
    world = World()
    rollout = _rollout(item, world)
    probe = GuardProbe(rollout, EpisodeSampler(world).sample(item.seed, "none", rnn=item.rnn), item.level, item.ticks)
    directions = np.eye(ARM_JOINTS)[[joint - 1 for joint in item.joints]]
    with tqdm(total=item.grid**2, desc="grid", unit="point", disable=None) as bar:
        grid = scan(probe, directions, item.reach, item.grid, bar.update)
    angles = 2 * np.pi * np.arange(item.rays) / item.rays
    found_points = [
        bisect(probe, directions, item.reach, angle)
        for angle in tqdm(angles, desc="bisection", unit="ray", disable=None)
    ]
    points = [point for point in found_points if point is not None]
    gamma = float(rollout.policy.gamma)
    found = report(grid, points, gamma)
    setting = {
        "joints": item.joints,
        "level": item.level,
        "ticks": item.ticks,
        "gamma": gamma,
        "tick_of_the_run": probe.tick,
    }
    table = {
        "coordinates_deg": grid.coordinates.tolist(),
        "alpha": grid.alpha.tolist(),
        "errors": grid.error.tolist(),
    }
    _write(item, "guard", found | setting | table)
    title = f"alpha over {item.ticks} ticks after a displacement, {item.level:.2f} m before the can (seed {item.seed})"
    labels = tuple(f"displacement of joint {joint} (deg)" for joint in item.joints)
    save_guard(grid, points, (labels[0], labels[1]), gamma, title, item.out / "guard.png")
    if not points:
        print(f"no ray leaves mode task within {item.reach} deg: choose a larger --reach")
        return 1
    print(
        f"{len(points)} points of the surface, {found['smallest_detected_deg']:.2f} to {found['largest_on_surface_deg']:.2f} deg from no "
        f"displacement; off the grid's by at most {found['bisection_error']:.3f} deg (resolution {found['resolution']:.3f})"
    )
    return 0 if holds(found) else 1


def run_falsify(item: Falsify) -> int:
    """See Falsify."""
    for name in ("optuna", "cmaes"):
        if importlib.util.find_spec(name) is None:
            raise InputError(f"the search needs {name}: pip install -e '.[analysis]'")
    from diagrams.episodes.record import record_hash
    from diagrams.episodes.sampling import EpisodeSampler, episode_seeds
    from diagrams.hybrid import falsification as f
    from diagrams.hybrid.falsification_report import report, save_search
    from diagrams.hybrid.perturbations import NominalRun, Push, PushBuilder
    from diagrams.world.inverse_kinematics import HandKinematics
    from diagrams.world.scenario import load_scenario
    from diagrams.world.station import PickPlaceStation

    world, (encoder, policy) = World(), _networks(item)
    if policy.gamma is None:
        raise InputError(f"{item.rnn}.safetensors has no calibration: run diagrams/calibrate.py on it")
    draws, station = EpisodeSampler(world), PickPlaceStation(world, camera=False)
    hand = HandKinematics(world.initial_posture[:-1])
    seeds = episode_seeds("validation", item.seed, item.scenes)
    scenes = [draws.sample(seed, "none", rnn=item.rnn) for seed in seeds]
    identity = {
        "seed": item.seed, "scenes": item.scenes, "rnn": item.rnn, "weights_hash": policy.hash,
        "encoder_hash": encoder.hash, "world": repr(world),
    }  # fmt: skip
    log = f.TrialLog(item.out / "falsify_trials.jsonl", identity)
    files: dict[tuple[str, int], str] = {}

    def keep(name: str, number: int, trial: f.Trial) -> None:
        """Counterexamples are on disk as they come: a search takes long."""
        if trial.failure is not None:
            file = files[name, number] = f"{name}-{number + 1}.yaml"
            scenario = f.scenario_of(world, scenes[trial.push.scene], trial.disturbance)
            save_scenario(item.out / file, scenario, _words(item, file, trial, policy.hash))

    paths = item.weights / "cae.safetensors", item.weights / f"{item.rnn}.safetensors"
    with f.Pool(world, *paths, item.workers) as pool:
        print(f"the undisturbed runs of {len(scenes)} scenes ...", flush=True)
        nominal = pool.run(scenes)
        for scene, (outcome, _) in zip(scenes, nominal, strict=True):
            if outcome.switched:
                raise InputError(
                    f"the undisturbed run of the scene {scene.seed} already switches: choose another --seed or fewer --scenes"
                )
        builders = [
            PushBuilder(world, scene, NominalRun.of(record, hand, station.spot(scene.vacant)))
            for scene, (_, record) in zip(scenes, nominal, strict=True)
        ]

        def run(push: Push, disturbance: Any) -> f.Trial:
            episode = dataclasses.replace(scenes[push.scene], disturbance=disturbance)
            return f.Trial.of(push, disturbance, *pool.run([episode])[0], float(policy.gamma))

        found = f.search_all(
            len(scenes), lambda push: builders[push.scene].disturbance(push), run, item.trials, item.seed, log,
            on_trial=keep,
        )  # fmt: skip
        result = report(found, files, scenes)
        # The smallest of each sampler again, from its file.
        cases = {case["sampler"]: case for case in reversed(result["counterexamples"])}
        again = pool.run([draws.episode(load_scenario(item.out / case["file"])) for case in cases.values()])
    replayed = {
        name: {"file": case["file"], "same_failure": outcome.switch_failure == case["failure"],
               "same_bits": record_hash(record) == case["record_hash"]}
        for (name, case), (outcome, record) in zip(cases.items(), again, strict=True)
    }  # fmt: skip
    undisturbed = [outcome.success for outcome, _ in nominal]
    _write(item, "falsify", result | {"undisturbed_success": undisturbed, "replayed": replayed})
    save_search(found, item.out / "falsify.png")
    for name in found:
        smallest = result["smallest_magnitude"][name]
        print(
            f"{name}: first counterexample after {result['trials_to_first'][name]} of {result['trials'][name]} trials, smallest magnitude "
            f"{'none' if smallest is None else f'{smallest:.3f}'}; {result['failures'][name]}"
        )
    return 0 if all(case["same_bits"] for case in replayed.values()) else 1


def _words(item: Falsify, file: str, trial: Any, weights_hash: str) -> list[str]:
    """What a scenario file of a counterexample says of itself."""
    weights = "" if item.weights == WEIGHTS else " --weights DIR"
    return [
        f"{trial.failure}: {trial.push.form} of {trial.moved_deg:.1f} deg, {trial.push.ticks} ticks, in subtask {trial.push.subtask}",
        f"{item.rnn}.safetensors with the hash {weights_hash[:16]}; record {trial.digest[:16]}",
        f"python diagrams/pick_place.py --scenario {file}{weights}",
    ]


def run_states(item: States) -> int:
    """See States."""
    from diagrams.drawing.graph import save_graph
    from diagrams.episodes.sampling import EpisodeSampler
    from diagrams.hybrid.states import report, table

    world = World()
    rollout = _rollout(item, world)
    rollout.prepare(EpisodeSampler(world).sample(item.seed, "none", rnn=item.rnn))
    found = report(rollout.diagram, rollout.simulator.get_context())
    _write(item, "states", found)
    save_graph(rollout.diagram, item.out / "graph.svg")
    save_graph(rollout.diagram, item.out / "graph.png")
    print(table(found))
    return 0 if found["agree"] else 1


ITEMS: dict[str, tuple[type[Common], Callable[[Any], int]]] = {
    "modes": (Modes, run_modes),
    "return": (Return, run_return),
    "linearize": (Linearize, run_linearize),
    "guard": (Guard, run_guard),
    "falsify": (Falsify, run_falsify),
    "states": (States, run_states),
}


def parse(arguments: list[str] | None = None) -> Common:
    """The item and its options from the command line."""
    items: dict[str, Callable[..., Common]] = {name: item for name, (item, _) in ITEMS.items()}
    return tyro.extras.subcommand_cli_from_dict(items, description=__doc__, args=arguments)


if __name__ == "__main__":
    try:
        sys.exit(main(parse()))
    except (InputError, WeightsError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
