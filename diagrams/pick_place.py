"""Runs one episode: the arm picks the can, is disturbed, goes home, and finishes the task.

    python diagrams/pick_place.py

Exit code 0: task done; 1: the task failed; 2: bad input.
"""

import cProfile
import json
import logging
import math
import sys
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.hands_schedule import HandsSchedule
from diagrams.world.names import ENCODER, WEIGHTS
from diagrams.world.scenario import Scenario, load_scenario, load_world
from models.command_line import require, require_writable, run
from models.errors import InputError


@dataclass
class DisturbanceArguments(DisturbanceSpec):
    """A DisturbanceSpec, its kind as --disturbance (see systems/disturbance.py; moved: the can alone)."""

    # none, A, B, moved (the can alone), or a fault: diagrams/FAULTS.md lists them
    kind: Annotated[str, tyro.conf.arg(name="disturbance", prefix_name=False)] = "A"
    severity: Annotated[float, tyro.conf.arg(prefix_name=False)] = 1.0  # of a fault, 0 to 1


@dataclass
class PickPlaceArguments(Scenario):
    """The switched controller picks and places, once."""

    disturbance: DisturbanceArguments = field(default_factory=DisturbanceArguments)
    hands: tyro.conf.Suppress[HandsSchedule] = field(default_factory=HandsSchedule)  # of a scenario file
    scenario: Path | None = None  # YAML over the defaults; options on the command line go over both
    # YAML file of the world, below what a scenario or options say of it
    world_file: Annotated[Path | None, tyro.conf.arg(name="world")] = None
    weights: Path = WEIGHTS  # folder of the trained networks
    replay: Path = Path("outputs/replay.html")  # 3-D replay that opens offline in a browser
    plot: Path = Path("outputs/timeline.png")  # postures, both controllers' steps and alpha over time
    graphviz: Path = Path("outputs/diagram.svg")  # the diagram: .dot, .svg or .png
    video: Path | None = None  # .mp4 of a camera that sees the whole arm
    film: Path | None = None  # .webp or .gif of the arm and what it imagines, around the disturbance
    json: Path | None = None  # the outcome
    record: Path | None = None  # .npz of every tick, with pictures, for figures.py and analysis.py
    mcap: Path | None = None  # .mcap of every tick, for Foxglove, Rerun and PlotJuggler
    meshcat: bool = False  # show the run live, on this machine only
    realtime_rate: float = 0.0  # 1: as fast as the real arm; 0: as fast as possible
    profile: bool = False  # print where a tick's time goes


def parse(arguments: list[str] | None = None) -> PickPlaceArguments:
    """Command line over scenario file over world file over defaults."""
    cli = tyro.cli(PickPlaceArguments, args=arguments, description=__doc__)
    if cli.scenario is not None or cli.world_file is not None:
        world = load_world(cli.world_file)
        loaded = Scenario(world=world) if cli.scenario is None else load_scenario(cli.scenario, world)
        given = vars(loaded) | {"disturbance": DisturbanceArguments(**vars(loaded.disturbance))}
        cli = tyro.cli(PickPlaceArguments, args=arguments, default=PickPlaceArguments(**given), description=__doc__)
    return cli


def main(cli: PickPlaceArguments) -> int:
    """Runs the episode that `cli` asks for; returns the exit code."""
    cli.check()
    if not 0.0 <= cli.realtime_rate < math.inf:
        raise InputError(
            f"the real-time rate {cli.realtime_rate} is negative or not finite: choose 0 (as fast as possible) or more"
        )
    print(f"sampling episode {cli.seed}, loading the networks and building the diagram ...", flush=True)
    from pydrake.geometry import Meshcat, MeshcatParams
    from tqdm import tqdm

    from diagrams.drawing import FILM_FORMATS, PLOT_FORMATS
    from diagrams.drawing.graph import FORMATS as GRAPH_FORMATS
    from diagrams.drawing.graph import save_graph
    from diagrams.episodes.calibration import controller_of, require_named, stored_calibration
    from diagrams.episodes.record import PICTURE_EVERY, save_record
    from diagrams.episodes.runner import build_rollout
    from diagrams.episodes.sampling import EpisodeSampler
    from diagrams.episodes.tick_table import tick_table

    formats = {
        cli.replay: (".html",), cli.plot: PLOT_FORMATS, cli.graphviz: GRAPH_FORMATS, cli.video: (".mp4",),
        cli.film: FILM_FORMATS, cli.json: (".json",), cli.record: (".npz",), cli.mcap: (".mcap",),
    }  # fmt: skip
    written = [path for path in formats if path is not None]
    for path in written:
        if path.suffix not in formats[path]:
            names = ", ".join(formats[path])
            raise InputError(f"{path.name} has no format that can be written: choose a name that ends in {names}")
    if cli.mcap is not None:
        require("foxglove")
    episode = EpisodeSampler(cli.world).episode(cli)
    controller = controller_of(cli.weights, cli.rnn, cli.detector, cli.policy)
    logging.getLogger("drake").setLevel(logging.WARNING)  # Meshcat tells its address also where nobody asked for it
    meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    for distraction in ("/Grid", "/Axes"):
        meshcat.SetProperty(distraction, "visible", False)
    meshcat.SetCameraPose([1.5, -0.9, 0.8], [0.35, 0.0, 0.15])  # the desk fills the view
    fault = episode.disturbance.kind if episode.disturbance.fault else None
    shown = dict(meshcat=meshcat, video=cli.video, hands=bool(cli.hands), fault=fault)
    rollout = build_rollout(cli.world, cli.weights / ENCODER, controller, **shown)
    if cli.policy is None:
        require_named(rollout.policy, cli.rnn, controller.policy)
    calibration = stored_calibration(cli.detector, rollout.policy, cli.weights)
    for path in written:
        require_writable(path)
    rollout.simulator.set_target_realtime_rate(cli.realtime_rate)
    if cli.meshcat:
        print(f"live view: {meshcat.web_url()}")
    (x, y), kind = episode.can_xy, episode.disturbance.label
    kind += f" at severity {episode.disturbance.severity:g}" if fault else ""
    print(f"can at ({x:.3f}, {y:.3f}) m, {episode.vacant} spot vacant, disturbance {kind}", flush=True)
    meshcat.StartRecording(set_visualizations_while_recording=cli.meshcat)
    profiler = cProfile.Profile()
    with tqdm(unit="tick", leave=False, disable=None) as bar, profiler if cli.profile else nullcontext():
        outcome, record = rollout.run(
            episode,
            on_event=lambda seconds, what: tqdm.write(f"{seconds:6.1f} s  {what}"),
            on_tick=lambda _: bar.update(),
            picture_every=1 if cli.mcap else PICTURE_EVERY if cli.record else 0,
            calibration=calibration,
        )
    word = "done" if outcome.success else f"failed ({outcome.failure})"
    word = "void: the disturbance never came" if outcome.void else word
    meshcat.StopRecording()
    meshcat.PublishRecording()
    if rollout.video is not None:
        rollout.video.Save()

    def to_mcap(path: Path) -> None:
        from diagrams.episodes.mcap_file import save_mcap

        save_mcap(path, record, outcome, cli.world)

    results: list[tuple[Path | None, Callable[[Path], object]]] = [
        (cli.json, lambda path: path.write_text(json.dumps(outcome.to_dict(), indent=2) + "\n")),
        (cli.record, lambda path: save_record(path, record, outcome)),
        (cli.mcap, to_mcap),
        (cli.replay, lambda path: path.write_text(meshcat.StaticHtml())),
    ]
    all_kept = all([_kept(path, write) for path, write in results if path is not None])
    title = f"{rollout.policy.name.upper()}, disturbance {kind}, seed {cli.seed}: task {word}"

    def draw_timeline() -> None:
        from diagrams.drawing.timeline import save_timeline  # not before the run: matplotlib

        save_timeline(record, cli.plot, title)

    def draw_film() -> None:
        from diagrams.drawing.film import save_film

        assert cli.film is not None
        save_film(record, cli.world, cli.film)

    _draw("timeline", draw_timeline)
    if cli.film is not None:
        _draw("film", draw_film)
    _draw("diagram", lambda: save_graph(rollout.diagram, cli.graphviz))
    stages = {"picked": outcome.picked, "placed": outcome.placed, "at the initial posture": outcome.home}
    print(f"task {word}: " + ", ".join(f"{stage} {'yes' if reached else 'no'}" for stage, reached in stages.items()))
    if episode.hands:
        print("switching not judged: a person's hands were in it")
    elif episode.disturbance.several:
        print("switching not judged: the arm was disturbed more than once")
    elif episode.disturbance.takes_arm and not outcome.void:
        delay = outcome.detection_delay_s
        switching = "as it should" if outcome.switch_success else f"failed ({outcome.switch_failure})"
        print(f"switching {switching}" + ("" if delay is None else f": noticed after {delay:.1f} s"))
    rate = f"{outcome.realtime_factor:.1f} times real time"
    print(f"{outcome.sim_seconds:.1f} s simulated in {outcome.wall_seconds:.1f} s ({rate})")
    if cli.profile:
        print(tick_table(profiler, len(record.time)))
    print(f"written: {', '.join(str(path) for path in written if path.exists())}")
    return (0 if outcome.success else 1) if all_kept else 2


def _kept(path: Path, write: Callable[[Path], object]) -> bool:
    """Whether `path` could be written, which is said if not: what else there is of the run is not lost with it."""
    try:
        write(path)
    except OSError as error:
        print(f"error: {path} cannot be written ({error.strerror}): make room, or choose another", file=sys.stderr)
        return False
    return True


def _draw(what: str, draw: Callable[[], None]) -> None:
    """A picture that cannot be drawn does not undo the episode."""
    try:
        draw()
    except Exception as error:
        print(f"warning: the {what} could not be drawn: {' '.join(str(error).split())}", file=sys.stderr)


if __name__ == "__main__":
    run(main, parse)
