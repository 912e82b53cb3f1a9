"""Runs one episode: the arm picks the can, is disturbed, goes home, and finishes the task.

    python diagrams/pick_place.py

Exit code 0: task done; 1: the task failed; 2: bad input.
"""

import cProfile
import json
import logging
import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.hands_schedule import HandsSchedule
from diagrams.world.names import ENCODER, WEIGHTS
from diagrams.world.scenario import Scenario, load_scenario, load_world, naming_file
from models.checks import require_apart, require_one_of
from models.command_line import REMEDIES, require, require_writable, run, say
from models.errors import InputError
from models.files.container import partial_of, remove_left_parts, write_text
from systems.recoveries.registry import SHIPPED


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
    require_one_of(arguments, "--rnn", "--policy")
    if cli.scenario is not None or cli.world_file is not None:
        world = load_world(cli.world_file)
        loaded = Scenario(world=world) if cli.scenario is None else load_scenario(cli.scenario, world)
        given = vars(loaded) | {"disturbance": DisturbanceArguments(**vars(loaded.disturbance))}
        cli = tyro.cli(PickPlaceArguments, args=arguments, default=PickPlaceArguments(**given), description=__doc__)
    return cli


def main(cli: PickPlaceArguments) -> int:
    """Runs the episode that `cli` asks for; returns the exit code."""
    video = None if cli.video is None else partial_of(cli.video)
    try:
        if cli.video is not None:
            remove_left_parts(cli.video)
        return _run(cli, video)
    finally:
        if video is not None:
            video.unlink(missing_ok=True)


def _run(cli: PickPlaceArguments, video: Path | None) -> int:
    """As `main`; the frames go to the file `video`, until it is whole."""
    with naming_file(cli.scenario):
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
    from diagrams.episodes.real_time import RealTime, tick_words
    from diagrams.episodes.record import PICTURE_EVERY, save_record
    from diagrams.episodes.runner import build_rollout
    from diagrams.episodes.sampling import EpisodeSampler
    from diagrams.episodes.tick_table import tick_table
    from diagrams.episodes.video import save_video
    from diagrams.world.requirements import broken

    formats = {
        "replay": (".html",), "plot": PLOT_FORMATS, "graphviz": GRAPH_FORMATS, "video": (".mp4",),
        "film": FILM_FORMATS, "json": (".json",), "record": (".npz",), "mcap": (".mcap",),
    }  # fmt: skip
    asked = {f"--{name}": path for name in formats if (path := getattr(cli, name)) is not None}
    require_apart(asked, {"--scenario": cli.scenario, "--world": cli.world_file})
    written = list(asked.values())
    for option, path in asked.items():
        if path.suffix not in formats[option[2:]]:
            names = ", ".join(formats[option[2:]])
            raise InputError(f"{option} {path} has no format that can be written: choose a name that ends in {names}")
    if cli.mcap is not None:
        require("foxglove")
    with naming_file(cli.scenario):
        episode = EpisodeSampler(cli.world).episode(cli)
    controller = replace(controller_of(cli.weights, cli.rnn, cli.detector, cli.policy), recovery=cli.recovery)
    logging.getLogger("drake").setLevel(logging.WARNING)  # Meshcat tells its address also where nobody asked for it
    meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    for distraction in ("/Grid", "/Axes"):
        meshcat.SetProperty(distraction, "visible", False)
    meshcat.SetCameraPose([1.5, -0.9, 0.8], [0.35, 0.0, 0.15])  # the desk fills the view
    fault = episode.disturbance.kind if episode.disturbance.fault else None
    shown = dict(meshcat=meshcat, video=video, hands=bool(cli.hands), fault=fault, monitored=True)
    rollout = build_rollout(cli.world, cli.weights / ENCODER, controller, **shown)
    if cli.policy is None:
        require_named(rollout.policy, cli.rnn, controller.policy)
    calibration = stored_calibration(cli.detector, rollout.policy, cli.weights)
    for path in written:
        require_writable(path)
    clock = RealTime(cli.world.timing.period, cli.realtime_rate)
    if cli.meshcat:
        print(f"live view: {meshcat.web_url()}")
    (x, y), kind = episode.can_xy, episode.disturbance.label
    kind += f" at severity {episode.disturbance.severity:g}" if fault else ""
    print(f"can at ({x:.3f}, {y:.3f}) m, {episode.vacant} spot vacant, disturbance {kind}", flush=True)
    meshcat.StartRecording(set_visualizations_while_recording=cli.meshcat)
    profiler = cProfile.Profile()
    with tqdm(unit="tick", leave=False, disable=None) as bar, profiler if cli.profile else nullcontext():

        def after_tick(ticks: int) -> None:
            bar.update()
            clock.wait(ticks)

        outcome, record = rollout.run(
            episode,
            on_event=lambda seconds, what: tqdm.write(f"{seconds:6.1f} s  {what}"),
            on_tick=after_tick,
            picture_every=1 if cli.mcap else PICTURE_EVERY if cli.record else 0,
            calibration=calibration,
        )
    word = "done" if outcome.success else f"failed ({outcome.failure})"
    word = "void: the disturbance never came" if outcome.void else word
    meshcat.StopRecording()
    meshcat.PublishRecording()

    def to_mcap(path: Path) -> None:
        from diagrams.episodes.mcap_file import save_mcap

        save_mcap(path, record, outcome, cli.world)

    def to_video(path: Path) -> None:
        assert video is not None
        save_video(rollout.video, video, len(record.time), path)

    def draw_timeline(path: Path) -> None:
        from diagrams.drawing.timeline import save_timeline  # not before the run: matplotlib

        led = "" if outcome.recovery == SHIPPED else f", recovery {outcome.recovery}"
        title = f"{rollout.policy.name.upper()}, disturbance {kind}, seed {cli.seed}{led}: task {word}"
        save_timeline(record, path, title)

    def draw_film(path: Path) -> None:
        from diagrams.drawing.film import save_film

        save_film(record, cli.world, path)

    results: list[tuple[Path | None, Callable[[Path], object]]] = [
        (cli.json, lambda path: write_text(path, json.dumps(outcome.to_dict(), indent=2) + "\n")),
        (cli.record, lambda path: save_record(path, record, outcome)),
        (cli.mcap, to_mcap),
        (cli.video, to_video),
        (cli.replay, lambda path: write_text(path, meshcat.StaticHtml())),
    ]
    pictures: list[tuple[str, Path | None, Callable[[Path], object]]] = [
        ("timeline", cli.plot, draw_timeline),
        ("film", cli.film, draw_film),
        ("diagram", cli.graphviz, partial(save_graph, rollout.diagram)),
    ]
    all_kept = all([_kept(path, write) for path, write in results if path is not None])
    all_kept &= all([_drawn(*each) for each in pictures])
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
    if outcome.judged and (missed := broken(record.signals, cli.world.timing.period)):
        by = rollout.requirements.robustness(rollout.simulator.get_context())
        words = ", ".join(f"{name} by {-by[name]:.3g}" for name in missed)
        print(f"requirements broken: {words} (diagrams/world/requirements.stl)")
    rate = f"{outcome.realtime_factor:.1f} times real time"
    print(f"{outcome.sim_seconds:.1f} s simulated in {outcome.wall_seconds:.1f} s ({rate})")
    if cli.realtime_rate:
        print(tick_words(record.tick_seconds, clock.due))
    if cli.profile:
        print(tick_table(profiler, len(record.time)))
    print(f"written: {', '.join(str(path) for path in written if path.exists())}")
    return (0 if outcome.success else 1) if all_kept else 2


def _kept(path: Path, write: Callable[[Path], object]) -> bool:
    """Whether `path` could be written, which is said if not: what else there is of the run is not lost with it."""
    try:
        write(path)
    except OSError as error:
        remedy = REMEDIES.get(error.errno or 0, "choose another")
        say(f"error: {path} cannot be written ({error.strerror}): {remedy}")
        return False
    return True


def _drawn(what: str, path: Path | None, draw: Callable[[Path], object]) -> bool:
    """As `_kept`; a picture that cannot be drawn for another reason does not undo the episode, and is a warning."""
    try:
        return path is None or _kept(path, draw)
    except Exception as error:
        say(f"warning: the {what} could not be drawn: {error}")
        return True


if __name__ == "__main__":
    run(main, parse)
