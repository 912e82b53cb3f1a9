"""Figures 4 to 7 of the paper, and switching success against gamma.

    python diagrams/figures.py --out outputs/figures --sweep outputs/sweep outputs/sweep_gamma
    python diagrams/figures.py --out outputs/figures --record outputs/sweep/records/lstm-0-recall-own-B-2070000.npz

Figs. 5 to 7 need every tick: the episodes are run again, and come out as in the sweep, to the bit. With --sweep they are the first ones in
which all went well; without it the first ones of --seed. From --record, one or several, Figs. 5 and 7 are drawn as they are; for the pictures
of Fig. 6 the episode is run again. Fig. 4 is drawn from the weight files, the curve of gamma from a sweep with several values of --gamma, which
is given beside one with the calibrated gamma.
Exit code 2: bad input.
"""

from __future__ import annotations

import importlib.util
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tyro

from diagrams.episodes.calibration import policy_name
from diagrams.episodes.episode import Episode, Outcome
from diagrams.episodes.record import Record, load_record, record_hash
from diagrams.episodes.rollout import Rollout
from diagrams.episodes.sampling import EpisodeSampler, episode_seeds
from diagrams.world.configuration import World
from diagrams.world.names import DISTURBANCES, WEIGHTS
from models.errors import InputError
from models.files.weights import WeightsError, load_autoencoder
from models.networks import NETWORKS

if TYPE_CHECKING:
    import pandas as pd

LOOK_EVERY = 5  # ticks between two pictures that are kept
TRAINING_SEEDS = range(10)
CANDIDATES = 200  # seeds to look through for a run in which the can is taken from the hand
PICTURES = ("camera", r"decoded $f_k$", r"decoded $f^R_{k+1}$")


@dataclass
class FiguresArguments:
    """Command line of figures.py."""

    out: Path = Path("outputs/figures")
    sweep: list[Path] = field(default_factory=list)  # folders of sweeps
    record: list[Path] = field(default_factory=list)  # of pick_place.py --log or sweep.py --log, one a disturbance
    rnn: str = "lstm"  # of Figs. 5 to 7
    training_seed: int = 0
    seed: int = 0  # of the episodes, without --sweep and --record
    weights: Path = WEIGHTS


@dataclass
class Looks:
    """What the camera and the network saw: tick, picture uint8 (112, 112, 3), predicted features (30,)."""

    tick: list[int]
    rgb: list[np.ndarray]
    predicted: list[np.ndarray]


def recall_losses(weights: Path) -> dict[str, np.ndarray]:
    """By the network's name (training seeds, N): the calibration's mean recall errors, n = 1..N, of the weight files that are there."""
    from models.files.weights import load_policy

    losses = {}
    for rnn in NETWORKS:
        paths = [path for seed in TRAINING_SEEDS if (path := weights / policy_name(rnn, seed)).is_file()]
        rows = [stored.mean_errors[1:] for path in paths if (stored := load_policy(path)).mean_errors is not None]
        if rows:
            losses[rnn] = np.array(rows)
        else:
            print(f"Fig. 4: {rnn} has no calibrated weights in {weights}: left out")
    return losses


def read_sweeps(folders: list[Path]) -> pd.DataFrame:
    """The episodes of the sweeps in `folders`; raises InputError for a folder without, and for an episode that two of them have."""
    import pandas as pd

    tables = []
    for folder in folders:
        path = folder / "episodes.parquet"
        if not path.is_file():
            raise InputError(f"{path} does not exist: run diagrams/sweep.py with --out {folder}, to its end")
        try:
            tables.append(pd.read_parquet(path))
        except (OSError, ValueError) as error:  # pyarrow's errors are ValueErrors
            raise InputError(f"{path} is damaged ({error}): delete it, and run the sweep again") from error
    rows = pd.concat([table.astype(object) for table in tables], ignore_index=True).infer_objects()
    if rows.duplicated(["rnn", "training_seed", "detector", "gamma", "disturbance", "seed"]).any():
        raise InputError(
            f"some episodes are in several of {', '.join(map(str, folders))}: they would count twice, give one"
        )
    return rows


def read_records(paths: list[Path], rnn: str, weights_hash: str) -> dict[str, tuple[Record, dict]]:
    """By the disturbance, records and outcomes; raises InputError for two of one disturbance and for a run of another network or detector."""
    found: dict[str, tuple[Record, dict]] = {}
    for path in paths:
        record, outcome = load_record(path)
        if outcome["weights_hash"] != weights_hash or outcome["detector"] != "recall":
            raise InputError(
                f"{path} is a run of other weights than {rnn}'s, or of another detector than the recall: "
                "give --weights, --rnn and --training-seed of that run"
            )
        if outcome["disturbance"] in found:
            raise InputError(f"{path} is a second record of disturbance {outcome['disturbance']}: give one of each")
        found[outcome["disturbance"]] = record, outcome
    return found


def require_same(outcome: Outcome, rows: pd.DataFrame) -> None:
    """Raises InputError unless the episode came out as in the sweep's row of the same weights."""
    row = rows[
        (rows["seed"] == outcome.seed)
        & (rows["disturbance"] == outcome.disturbance)
        & (rows["weights_hash"] == outcome.weights_hash)
        & (rows["detector"] == outcome.detector)
        & rows["gamma"].isna()
    ]
    fields = ("success", "switch_success", "sim_seconds", "alpha_max_before")
    if row.empty or any(row.iloc[0][name] != getattr(outcome, name) for name in fields):
        raise InputError(
            f"episode {outcome.seed} under disturbance {outcome.disturbance} does not come out as in the sweep: "
            "give --weights of the sweep, and the version of this program that made it"
        )


def choose(kind: str, rows: pd.DataFrame | None, arguments: FiguresArguments, draws: EpisodeSampler) -> Episode:
    """The episode to show under that disturbance; under B one in which the can is taken from the hand, if there is one."""
    if rows is None:
        seeds = episode_seeds("evaluation", arguments.seed, CANDIDATES if kind == "B" else 1)
    else:
        mine = rows[
            (rows["rnn"] == arguments.rnn)
            & (rows["training_seed"] == arguments.training_seed)
            & (rows["detector"] == "recall")
            & (rows["disturbance"] == kind)
            & rows["gamma"].isna()
            & rows["success"].notna()
        ]
        if mine.empty:
            raise InputError(
                f"the sweep has no episode of {arguments.rnn}, training seed {arguments.training_seed}, disturbance {kind}, "
                "with the calibrated gamma: run it, or leave --sweep out"
            )
        good = mine["success"].astype(int) + mine["switch_success"].astype(int)
        seeds = [int(seed) for seed in mine["seed"][good == good.max()]]
    for seed in seeds if kind == "B" else []:
        episode = draws.sample(seed, kind, rnn=arguments.rnn)
        if episode.disturbance.can_moved_to is not None:
            return episode
    return draws.sample(seeds[0], kind, rnn=arguments.rnn)


def run(rollout: Rollout, episode: Episode) -> tuple[Outcome, Record, Looks]:
    """Runs the episode and looks at it now and then."""
    from tqdm import tqdm

    looks = Looks([], [], [])

    def look(ticks: int) -> None:
        bar.update()
        if (ticks - 1) % LOOK_EVERY == 0:
            context = rollout.simulator.get_context()
            image = rollout.station.GetOutputPort("rgb_image").Eval(rollout.station.GetMyContextFromRoot(context))
            predicted = rollout.controller.GetOutputPort("predicted_features")
            looks.tick.append(ticks - 1)
            looks.rgb.append(image.data[:, :, :3].copy())
            looks.predicted.append(predicted.Eval(rollout.controller.GetMyContextFromRoot(context)).copy())

    with tqdm(desc=f"disturbance {episode.disturbance.kind}", unit="tick", leave=False, disable=None) as bar:
        outcome, record = rollout.run(episode, on_tick=look)
    return outcome, record, looks


def reconstructions(record: Record, looks: Looks, encoder, decoder) -> list[tuple[float, str, list[np.ndarray]]]:
    """For each event the picture next to it, what the autoencoder makes of it, and what it makes of the predicted features."""
    import torch

    def decode(features: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            image = decoder.decode(torch.from_numpy(features)[None].float())[0]
        return (255.0 * image.clamp(0.0, 1.0)).byte().permute(1, 2, 0).numpy()

    happened: dict[int, list[str]] = {}
    for seconds, what in record.events:
        happened.setdefault(int(np.argmin(np.abs(record.time[looks.tick] - seconds))), []).append(what)
    return [
        (
            float(record.time[looks.tick[n]]),
            "; ".join(words),
            [looks.rgb[n], decode(encoder.encode(looks.rgb[n])), decode(looks.predicted[n])],
        )
        for n, words in happened.items()
    ]


def subtasks(home: np.ndarray, held: np.ndarray) -> np.ndarray:
    """(n,) 1 or 2: a subtask ends when the arm is at its initial posture; then the can is in the hand (2) or not (1).

    `home`, `held`: (n,) bool.
    """
    last_home = np.maximum.accumulate(np.where(home, np.arange(len(home)), -1))
    return np.where((last_home >= 0) & held[last_home], 2, 1)


def principal_states(
    records: dict[str, Record], world: World
) -> tuple[dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]], np.ndarray, np.ndarray]:
    """What plots.save_states draws: the runs on the first principal components of all their hidden states, c_0 there, and the ratios."""
    from sklearn.decomposition import PCA

    from diagrams.world.names import CAN_HALF_HEIGHT
    from diagrams.world.task import HOME_TOLERANCE, LIFTED

    pca = PCA(3).fit(np.concatenate([record.hidden_state for record in records.values()]))
    runs = {}
    for title, record in records.items():
        home = np.all(np.abs(record.posture - world.initial_posture)[:, :-1] < HOME_TOLERANCE, axis=1)
        held = (record.posture[:, -1] < 0.5 * world.opening) & (record.can_poses[:, 6] > CAN_HALF_HEIGHT + LIFTED)
        runs[title] = (pca.transform(record.hidden_state), subtasks(home, held), record.alpha)
    origin = pca.transform(np.zeros((1, pca.n_features_in_)))[
        0
    ]  # c_0, to which every subtask's last state is drawn in training
    return runs, origin, pca.explained_variance_ratio_


def gamma_curves(rows: pd.DataFrame) -> tuple[dict[str, list], dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Switching success of each controller and disturbance at each gamma, and its upper bound from the runs at the largest gamma.

    A run is the same under each gamma until an error first reaches it. So what the largest gamma let happen says for every smaller one, without
    another run, whether there would have been a false alarm and whether the disturbance would have been noticed; not whether the return and the
    resumption would have gone well, which takes the runs.
    """
    from diagrams.sweeps.summary import cells

    swept = rows[rows["gamma"].notna()]
    curves: dict[str, list] = {}
    for cell in sorted(cells(swept), key=lambda cell: cell["gamma"]):
        label = f"{cell['rnn'].upper()} {cell['detector']}, {'no disturbance' if cell['disturbance'] == 'none' else cell['disturbance']}"
        curves.setdefault(label, []).append(
            {name: cell[name] for name in ("rnn", "detector", "disturbance", "gamma")} | cell["switching"]
        )
    bounds = {}
    for label, points in curves.items():
        last = points[-1]
        same = np.logical_and.reduce(
            [swept[name] == last[name] for name in ("rnn", "detector", "disturbance", "gamma")]
        )
        cell_rows = swept[same]
        gammas = np.geomspace(points[0]["gamma"], last["gamma"], 200)
        quiet = cell_rows["error_peak_normal"].to_numpy()[:, None] < gammas
        seen = cell_rows["error_peak_disturbed"].to_numpy()[:, None] >= gammas
        good = quiet if last["disturbance"] == "none" else quiet & seen
        bounds[label] = (gammas, good.mean(axis=0))
    return {label: points for label, points in curves.items() if len(points) > 1}, bounds


def main(arguments: FiguresArguments) -> int:
    """Writes the figures and figures.json; returns the exit code."""
    import torch

    from diagrams.drawing import paper_figures as plots
    from models.inference import Encoder, Policy

    for name in ("sklearn", "pandas"):
        if importlib.util.find_spec(name) is None:
            raise InputError(f"the figures need {name}: pip install -e '.[sweep]'")
    if arguments.rnn not in NETWORKS:
        raise InputError(f"there is no rnn '{arguments.rnn}': choose one of {', '.join(NETWORKS)}")
    torch.set_num_threads(1)  # as in every sweep: the sums are the same
    world, out = World(), arguments.out
    encoder_path = arguments.weights / "cae.safetensors"
    encoder, decoder = Encoder(encoder_path), load_autoencoder(encoder_path)[0]
    policy = Policy(arguments.weights / policy_name(arguments.rnn, arguments.training_seed))
    if arguments.sweep and arguments.record:
        raise InputError("both --sweep and --record are given: choose one")
    rows = read_sweeps(arguments.sweep) if arguments.sweep else None
    given = read_records(arguments.record, arguments.rnn, policy.hash)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out} cannot be written ({error.strerror}): choose another --out") from error
    notes: dict[str, Any] = {"rnn": arguments.rnn, "weights_hash": policy.hash}

    losses = recall_losses(arguments.weights)
    if losses:
        plots.save_recall_loss(losses, out / "fig4_recall_loss.png")
        notes["recall_loss"] = {name: values.tolist() for name, values in losses.items()}

    draws, rollout = EpisodeSampler(world), Rollout(world, encoder, policy)
    records = {kind: record for kind, (record, _) in given.items()}
    notes["episodes"] = {kind: outcome for kind, (_, outcome) in given.items()}
    looks: dict[str, Looks] = {}
    if given:
        # Pictures are in no record.
        shown = "B" if "B" in given else list(given)[-1]
        record, was = given[shown]
        episode = draws.sample(was["seed"], shown, tuple(was["can_xy"]), was["vacant"], rnn=arguments.rnn)
        _, again, seen = run(rollout, episode)
        if record_hash(again) == record_hash(record):
            looks[shown] = seen
        else:
            print("Fig. 6: the record does not come out again from its seed (a --scenario of its own?): left out")
    else:
        for kind, episode in {kind: choose(kind, rows, arguments, draws) for kind in DISTURBANCES}.items():
            outcome, records[kind], looks[kind] = run(rollout, episode)
            if rows is not None:
                require_same(outcome, rows)
            notes["episodes"][kind] = outcome.to_dict()
    for kind, outcome in notes["episodes"].items():
        word = "done" if outcome["success"] else f"failed ({outcome['failure']})"
        print(f"disturbance {kind}: episode {outcome['seed']}, task {word}", flush=True)
    plots.save_sequences(records, out / "fig5_sequences.png")
    if looks:
        shown = list(looks)[-1]
        columns = reconstructions(records[shown], looks[shown], encoder, decoder)
        plots.save_reconstructions(columns, PICTURES, out / "fig6_reconstructions.png")
    titles = {"none": "no disturbance", "A": "disturbance A", "B": "disturbance B"}
    compared = {titles[kind]: record for kind, record in records.items() if given or kind != "A"}
    states, origin, ratios = principal_states(compared, world)
    plots.save_states(states, origin, ratios, out / "fig7_states.png")
    notes["contribution_ratios"] = ratios.tolist()
    print(
        "contribution ratios of the hidden states: "
        + ", ".join(f"PC{i + 1} {100 * r:.1f} %" for i, r in enumerate(ratios))
    )

    curves, bounds = gamma_curves(rows) if rows is not None else ({}, {})
    if curves:
        plots.save_gamma_curve(curves, bounds, out / "gamma.png")
        notes["gamma"] = curves
    else:
        print("no sweep with several values of --gamma: its curve is left out")
    (out / "figures.json").write_text(json.dumps(notes, indent=1) + "\n")
    print(f"written: {', '.join(str(path) for path in sorted([*out.glob('*.png'), out / 'figures.json']))}")
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(tyro.cli(FiguresArguments, description=__doc__)))
    except (InputError, WeightsError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
