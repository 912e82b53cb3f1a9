"""Runs one episode: the arm picks the can, is disturbed, goes home, and finishes the task.

    python diagrams/pick_place.py

Exit code 0: task done; 1: the task failed; 2: bad input.
"""

from __future__ import annotations

import json
import logging
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from diagrams.world.scenario import WEIGHTS, Scenario, load_scenario
from models.errors import InputError


@dataclass
class PickPlaceArguments(Scenario):
    """The switched controller picks and places, once."""

    scenario: Path | None = None  # YAML over the defaults; options on the command line go over both
    graphviz: Path = Path("outputs/diagram.svg")  # the diagram: .dot, .svg or .png
    record: Path = Path("outputs/replay.html")  # 3-D replay that opens offline in a browser
    plot: Path = Path("outputs/timeline.png")  # postures, both controllers' steps and alpha over time
    video: Path | None = None  # .mp4 of a camera that sees the whole arm
    json: Path | None = None  # the outcome
    log: Path | None = None  # .npz of every tick, for analysis.py
    meshcat: bool = False  # show the run live, on this machine only
    realtime_rate: float = 0.0  # 1: as fast as the real arm; 0: as fast as possible
    weights: Annotated[Path, tyro.conf.arg(help="folder of the trained networks")] = field(
        default_factory=lambda: WEIGHTS
    )


def parse(arguments: list[str] | None = None) -> PickPlaceArguments:
    """Command line over scenario file over defaults."""
    arguments = sys.argv[1:] if arguments is None else arguments
    cli = tyro.cli(PickPlaceArguments, args=arguments)
    if cli.scenario is not None:
        loaded = load_scenario(cli.scenario)
        defaults = PickPlaceArguments(**{name: getattr(loaded, name) for name in Scenario.__dataclass_fields__})
        cli = tyro.cli(PickPlaceArguments, args=arguments, default=defaults)
    cli.check()
    if not 0.0 <= cli.realtime_rate < math.inf:
        raise InputError(
            f"the real-time rate {cli.realtime_rate} is negative or not finite: choose 0 (as fast as possible) or more"
        )
    return cli


def main(cli: PickPlaceArguments) -> int:
    """Runs the episode that `cli` asks for; returns the exit code."""
    print(f"drawing episode {cli.seed}, loading the networks and building the diagram ...", flush=True)
    import torch
    from pydrake.geometry import Meshcat, MeshcatParams
    from tqdm import tqdm

    from diagrams.drawing.graph import FORMATS, save_graph
    from diagrams.drawing.timeline import FORMATS as PLOT_FORMATS
    from diagrams.drawing.timeline import save_timeline
    from diagrams.episodes.calibration import make_detector
    from diagrams.episodes.record import save_record
    from diagrams.episodes.rollout import Rollout
    from diagrams.episodes.sampling import EpisodeSampler
    from models.inference import Encoder, Policy

    torch.set_num_threads(1)  # fastest at batch 1, and the sums of every evaluation
    for path, formats in (
        (cli.graphviz, FORMATS),
        (cli.plot, PLOT_FORMATS),
        (cli.video, (".mp4",)),
        (cli.log, (".npz",)),
    ):
        if path is not None and path.suffix not in formats:
            raise InputError(
                f"{path.name} has no format that can be written: choose a name that ends in {', '.join(formats)}"
            )
    episode = EpisodeSampler(cli.world).episode(cli)
    encoder, policy = Encoder(cli.weights / "cae.safetensors"), Policy(cli.weights / f"{cli.rnn}.safetensors")
    detector = make_detector(cli.detector, policy, cli.weights)
    logging.getLogger("drake").setLevel(logging.WARNING)  # Meshcat tells its address also where nobody asked for it
    meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    for distraction in ("/Grid", "/Axes"):
        meshcat.SetProperty(distraction, "visible", False)
    meshcat.SetCameraPose([1.5, -0.9, 0.8], [0.35, 0.0, 0.15])  # the desk fills the view
    rollout = Rollout(cli.world, encoder, policy, *detector, meshcat=meshcat, video=cli.video)
    written = [path for path in (cli.record, cli.plot, cli.graphviz, cli.video, cli.json, cli.log) if path is not None]
    for path in written:
        _prepare(path)
    rollout.simulator.set_target_realtime_rate(cli.realtime_rate)
    if cli.meshcat:
        print(f"live view: {meshcat.web_url()}")
    x, y = episode.can_xy
    print(
        f"can at ({x:.3f}, {y:.3f}) m, {episode.vacant} spot vacant, disturbance {episode.disturbance.kind}", flush=True
    )
    meshcat.StartRecording(set_visualizations_while_recording=cli.meshcat)
    with tqdm(unit="tick", leave=False, disable=None) as bar:
        outcome, record = rollout.run(
            episode,
            on_event=lambda seconds, what: tqdm.write(f"{seconds:6.1f} s  {what}"),
            on_tick=lambda _: bar.update(),
        )
    meshcat.StopRecording()
    meshcat.PublishRecording()
    if rollout.video is not None:
        rollout.video.Save()
    cli.record.write_text(meshcat.StaticHtml())
    if cli.json is not None:
        cli.json.write_text(json.dumps(outcome.to_dict(), indent=2) + "\n")
    if cli.log is not None:
        save_record(cli.log, record, outcome)
    word = "done" if outcome.success else f"failed ({outcome.failure})"
    save_timeline(
        record, cli.plot, f"{cli.rnn.upper()}, disturbance {outcome.disturbance}, seed {cli.seed}: task {word}"
    )
    save_graph(rollout.diagram, cli.graphviz)
    print(
        f"task {word}: picked {_yes(outcome.picked)}, placed {_yes(outcome.placed)}, at the initial posture {_yes(outcome.home)}"
    )
    if outcome.disturbance != "none":
        print(f"switching {'as it should' if outcome.switch_success else f'failed ({outcome.switch_failure})'}", end="")
        if outcome.detection_delay_s is not None:
            print(f": noticed after {outcome.detection_delay_s:.1f} s", end="")
        print()
    print(
        f"{outcome.sim_seconds:.1f} s simulated in {outcome.wall_seconds:.1f} s ({outcome.realtime_factor:.1f} times real time)"
    )
    print(f"written: {', '.join(str(path) for path in written)}")
    return 0 if outcome.success else 1


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def _prepare(path: Path) -> None:
    """Raises InputError unless `path` can be written, before an episode is run for it."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("ab").close()  # touch() is content with a folder
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror}): choose another name") from error


def _bad_input(error: Exception) -> int:
    print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    from models.files.weights import WeightsError

    try:
        sys.exit(main(parse()))
    except (InputError, WeightsError) as error:
        sys.exit(_bad_input(error))
