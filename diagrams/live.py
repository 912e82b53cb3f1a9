"""Plays with the arm in the browser: hold it, pull it, take its can, cover its camera, and look into its memory.

    python diagrams/live.py

The page is served on this machine alone. Ctrl-C ends it. Exit code 2: bad input.
"""

import logging
import os
import resource
import sys
import time
import webbrowser
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from diagrams.world.disturbance import DisturbanceSpec
from diagrams.world.hands_schedule import HandsSchedule
from diagrams.world.names import WEIGHTS
from diagrams.world.scenario import Scenario, load_world
from models.checks import require_one_of, require_plain
from models.command_line import require, require_writable, run, say
from models.errors import InputError

if TYPE_CHECKING:
    from diagrams.browser.run import Run

PORTS = range(1024, 65536)
SLOWEST = 0.05  # speed


@dataclass
class LiveArguments(Scenario):
    """The switched controller picks and places, and you disturb it."""

    disturbance: tyro.conf.Suppress[DisturbanceSpec] = field(default_factory=DisturbanceSpec)  # yours alone
    hands: tyro.conf.Suppress[HandsSchedule] = field(default_factory=HandsSchedule)
    # YAML file of the world, below what options say of it
    world_file: Annotated[Path | None, tyro.conf.arg(name="world")] = None
    weights: Path = WEIGHTS  # folder of the trained networks
    speed: float = 1.0  # simulated over real time, 0.05 or more; 0: as fast as possible
    # Where Save, the next scene and the end leave what was done, for pick_place.py --scenario; further scenes in
    # live-2.yaml and so on
    save: Path = Path("outputs/live.yaml")
    port: int = 5006  # of the page
    meshcat_port: int | None = None  # of the 3-D view in it; else a free one
    open: bool = True  # the page in a browser, where there is a display


def parse(arguments: list[str] | None = None) -> LiveArguments:
    """Command line over world file over defaults."""
    cli = tyro.cli(LiveArguments, args=arguments, description=__doc__)
    require_one_of(arguments, "--rnn", "--policy")
    if cli.world_file is not None:
        default = LiveArguments(world=load_world(cli.world_file))
        cli = tyro.cli(LiveArguments, args=arguments, default=default, description=__doc__)
    return cli


def main(cli: LiveArguments) -> int:
    """Runs until Ctrl-C, or another signal that ends it; returns the exit code."""
    cli.check()
    require("bokeh", "tornado")
    if cli.speed != 0.0 and not SLOWEST <= cli.speed < float("inf"):
        raise InputError(f"the speed {cli.speed} cannot be: choose 0 (as fast as possible) or {SLOWEST} and more")
    for name, port in (("port", cli.port), ("meshcat-port", cli.meshcat_port)):
        if port is not None and port not in PORTS:
            raise InputError(f"--{name} {port} is no port that can be had: choose from {PORTS[0]} to {PORTS[-1]}")
    require_plain(cli.save)  # a device would be written to at the end alone
    require_writable(cli.save)
    print("loading the networks and building the diagram ...", flush=True)
    from diagrams.browser.run import Run
    from diagrams.browser.scene import open_scene
    from diagrams.browser.server import serve
    from diagrams.browser.session import Session

    logging.getLogger("drake").setLevel(logging.WARNING)
    meshcat = open_scene(cli.meshcat_port)
    names = Scenario.__dataclass_fields__
    scenario = Scenario(**{name: getattr(cli, name) for name in names})
    live = Run(Session(scenario, cli.weights, meshcat), cli.speed, cli.save)

    def ready(url: str) -> None:
        print(f"the page: {url}  (Ctrl-C ends it)", flush=True)
        if cli.open and (sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            webbrowser.open(url)

    before = time.process_time()
    try:
        serve(live, cli.port, meshcat.web_url(), ready)
    finally:  # also where a tick raised: first of all what was done
        kept = _keep(live)
    used, largest = time.process_time() - before, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(live.pace.words())
    if live.delays:
        typical, most = (live.delays.quantile(share) for share in (0.5, 0.99))
        print(f"drawn {typical:.2f} s after the tick in the median, {most:.2f} s at 99 %")
    each = 1e3 * used / max(live.pace.ticks, 1)
    print(f"{each:.1f} ms of processor time a tick, with the pages; {largest:.0f} MiB of memory at most")
    return 0 if kept else 2


def _keep(live: "Run") -> bool:
    """Writes what is not written yet; False, and a line on stderr, where that cannot be done."""
    try:
        path = live.keep()
    except InputError as error:
        say(f"error: {error}")
        return False
    if path is not None:
        print(f"written: {path}")
    return True


if __name__ == "__main__":
    run(main, parse)
