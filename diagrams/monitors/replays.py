"""The 3-D replay and the pictures of one episode of a bench, made again from what the bench has kept."""

import dataclasses
import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from diagrams.browser.explorer import write_replays
from diagrams.episodes.calibration import UNCALIBRATED, Calibration, policy_name
from diagrams.episodes.record import PICTURE_EVERY
from diagrams.episodes.runner import build_rollout, prepared
from diagrams.monitors.bench_fit import NETWORKS, TOLD
from diagrams.monitors.bench_plan import BenchArguments, Network, in_loop, switched_off
from diagrams.monitors.bench_task import BenchTask, Scored, job_of
from diagrams.monitors.fitting import BETA
from diagrams.monitors.traces import PICTURES, SHOWN, kept_trace, pictures_file, require_same_run
from diagrams.world.scenario import load_world
from models.checks import require_plain
from models.errors import InputError
from models.files.container import write_bytes, write_text


def make_replay(folder: Path, key: str) -> int:
    """Runs the episode `key` of the bench in `folder` again and writes what its page shows; returns the exit code.

    Raises InputError where there is no such episode, and where the run is not the bench's, to the bit: of another code.
    """
    from tqdm import tqdm

    task = _task(folder, key)
    script = kept_trace(folder, key)
    job = dataclasses.replace(job_of(folder / NETWORKS, task), picture_every=PICTURE_EVERY)
    logging.getLogger("drake").setLevel(logging.WARNING)  # Meshcat tells its address
    from diagrams.browser.scene import open_scene

    meshcat = open_scene(None)
    _, episode, calibration = prepared(job)
    fault = episode.disturbance.kind if episode.disturbance.fault else None
    rollout = build_rollout(task.world, job.encoder, job.controller, meshcat=meshcat, fault=fault)
    meshcat.StartRecording(set_visualizations_while_recording=False)
    with tqdm(unit="tick", leave=False, disable=None) as bar:
        _, record = rollout.run(
            episode, on_tick=lambda _: bar.update(), picture_every=job.picture_every, calibration=calibration
        )
    require_same_run(script, record, folder, key)
    meshcat.StopRecording()
    meshcat.PublishRecording()
    replay, pictures = (folder / SHOWN / f"{key}{suffix}" for suffix in (".html", PICTURES))
    write_bytes(pictures, pictures_file(record))
    write_text(replay, meshcat.StaticHtml())
    write_replays(folder / SHOWN)
    print(f"the same run to the bit; written: {replay}, {pictures}")
    return 0


def _task(folder: Path, key: str) -> BenchTask:
    """What made the episode; raises InputError where the bench has none of that key."""
    option = f"--replay {key:.80}"
    found = next((task for task in tasks_of(folder, option) if task.key == key), None)
    if found is None:
        raise InputError(
            f"{option}: the bench in {folder} has no such episode: choose one that explorer.html there names"
        )
    return found


def tasks_of(folder: Path, option: str) -> list[BenchTask]:
    """Every episode that the page of the bench in `folder` may show; raises InputError where there is no bench.

    `option`: what the user gave, for messages.
    """
    path = folder / "summary.json"
    require_plain(path, "choose another --out")
    try:
        summary = json.loads(path.read_text())
        given = {name: value for name, value in summary["arguments"].items() if value is not None}
        given |= {name: Path(given[name]) for name in ("weights", "world") if name in given}
        return list(_tasks(folder, BenchArguments(**given), summary))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{option}: {path} is no summary of a bench ({error}): run the bench in --out, then ask again"
        ) from error


def _tasks(folder: Path, arguments: BenchArguments, summary: dict[str, Any]) -> Iterator[BenchTask]:
    """Every episode that the page of that bench may show."""
    from models.inference import Policy

    world = load_world(arguments.world)
    alarmed = {"error": None, "void": False}  # as a row is of which all detectors may act in the loop
    for seed in arguments.training_seeds:
        path = folder / NETWORKS / policy_name(arguments.rnn, seed)
        policy = Policy(path)
        network = Network(policy.name, seed, path, policy)
        detectors = tuple(
            Scored(spec, _calibration(label, summary["gammas"][path.stem]), "")
            for label, spec in arguments.specs.items()
        )
        row = alarmed | {"detectors": {scored.label: {"alarm": 0, "false_alarms": 0} for scored in detectors}}
        for task in switched_off(arguments, world, network, detectors):
            yield task
            yield from in_loop(arguments, task, row)


def _calibration(label: str, found: dict[str, Any]) -> Calibration:
    if label in UNCALIBRATED:
        return Calibration((1.0,), BETA, TOLD)
    return Calibration(tuple(found[label]["mean_errors"]), BETA, found[label]["gamma"])
