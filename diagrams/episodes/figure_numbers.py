"""What the paper's Figs. 4 to 7 show, as numbers: from weight files and from records, without running anything."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from diagrams.episodes.calibration import policy_name
from diagrams.episodes.record import Record, find_records, load_record
from diagrams.world.configuration import World
from diagrams.world.names import DISTURBANCES
from diagrams.world.task import at_home, held
from models.errors import InputError
from models.networks import NETWORKS

Coder = Callable[[np.ndarray], np.ndarray]
TRAINING_SEEDS = range(10)  # that are looked for


def recall_losses(weights: Path) -> dict[str, np.ndarray]:
    """By the network's name (training seeds, N): mean squared error of the joints recalled n = 1..N ticks back, scaled.

    Means over the episodes of the calibration, of the calibrated weight files that are there.
    """
    from models.files.policies import read_policy

    losses = {}
    for rnn in NETWORKS:
        paths = [path for seed in TRAINING_SEEDS if (path := weights / policy_name(rnn, seed)).is_file()]
        means = [mean for path in paths if (mean := read_policy(path)[0].mean_errors) is not None]
        if len(sizes := {len(mean) - 1 for mean in means}) > 1:
            lengths = " and ".join(map(str, sorted(sizes)))
            raise InputError(
                f"the files of '{rnn}' in {weights} recall {lengths} ticks: put networks of one length there"
            )
        if means:
            losses[rnn] = np.array(means)[:, 1:]
    return losses


def choose_records(paths: list[Path], weights_hash: str) -> dict[str, tuple[Record, dict]]:
    """By the disturbance, in the order of DISTURBANCES, the run that is shown: its record and its outcome.

    Of those in `paths` (records, or folders of them) with the detector `recall` and the weights of `weights_hash`, it
    is the first in which all went well; under B one in which the can was taken from the hand, if there is one. Raises
    InputError where none fits.
    """

    def merit(run: tuple[Record, dict]) -> tuple[int, bool]:
        record, outcome = run
        taken = any("taken" in what for _, what in record.events)
        return bool(outcome["success"]) + bool(outcome["switch_success"]), taken

    found: dict[str, tuple[Record, dict]] = {}
    files = find_records(paths)
    for run in map(load_record, files):
        _, outcome = run
        kind = outcome["disturbance"]
        if outcome["weights_hash"] == weights_hash and outcome["detector"] == "recall":
            found[kind] = max(found.get(kind, run), run, key=merit)
    if not found:
        raise InputError(
            f"none of {len(files)} records is a run of these weights with the detector recall: "
            "give --weights, --rnn and --training-seed of the run"
        )
    return {kind: found[kind] for kind in DISTURBANCES if kind in found}


def reconstructions(record: Record, encode: Coder, decode: Coder) -> list[tuple[float, str, list[np.ndarray]]]:
    """Of the picture next to each event: s, what happened, the picture, and its f and f^R_{k+1} decoded to pictures."""
    times, happened = record.time[record.picture_ticks], dict[int, list[str]]()
    for seconds, what in record.events:
        happened.setdefault(int(np.argmin(np.abs(times - seconds))), []).append(what)
    columns = []
    for n, words in happened.items():
        k = record.picture_ticks[n]
        seen = record.pictures[n]
        pictures = [seen, decode(encode(seen)), decode(record.predicted_features[k])]
        columns.append((float(times[n]), "; ".join(words), pictures))
    return columns


def subtasks(home: np.ndarray, held: np.ndarray) -> np.ndarray:
    """(n,) 1 or 2: a subtask ends when the arm is at its initial posture; then the can is in the hand (2) or not (1).

    `home`, `held`: (n,) bool.
    """
    last_home = np.maximum.accumulate(np.where(home, np.arange(len(home)), -1))
    return np.where((last_home >= 0) & held[last_home], 2, 1)


def principal_states(
    records: Mapping[str, Record], world: World
) -> tuple[dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]], np.ndarray, np.ndarray]:
    """The hidden states of all runs on their first three principal components.

    Returns, by the names in `records`, states (n, 3), the subtask (n,) 1 or 2, alpha (n,); the origin (3,) c_0 = 0, to
    which the last state of every subtask is drawn in training; and the contribution ratios (3,).
    """
    from sklearn.decomposition import PCA

    pca = PCA(3).fit(np.concatenate([record.hidden_state for record in records.values()]))
    runs = {}
    for name, record in records.items():
        home = at_home(record.posture[:, :-1], world.initial_posture[:-1])
        in_hand = held(record.can_poses, record.posture, world.opening)
        runs[name] = (pca.transform(record.hidden_state), subtasks(home, in_hand), record.alpha)
    return runs, pca.transform(np.zeros((1, pca.n_features_in_)))[0], pca.explained_variance_ratio_
