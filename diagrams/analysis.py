"""Analyses the switched controller as one hybrid system.

    python diagrams/analysis.py {modes,return,resume,cycle,linearize,guard,falsify,defeat,states} --out DIR

Each writes DIR/NAME.json and its pictures beside it. Exit code 0: what it checks holds; 1: it does not; 2: bad input.
"""

from collections.abc import Callable

import tyro

from diagrams.hybrid.common import Arguments
from diagrams.hybrid.cycle import Cycle
from diagrams.hybrid.defeat import Defeat
from diagrams.hybrid.falsification import Falsify
from diagrams.hybrid.guard import Guard
from diagrams.hybrid.modes import Modes
from diagrams.hybrid.resumption import Resume
from diagrams.hybrid.return_certificate import Return
from diagrams.hybrid.states import States
from diagrams.hybrid.switching_point import Linearize
from models.command_line import run

ANALYSES: dict[str, Callable[..., Arguments]] = {
    "modes": Modes, "return": Return, "resume": Resume, "cycle": Cycle, "linearize": Linearize, "guard": Guard,
    "falsify": Falsify, "defeat": Defeat, "states": States,
}  # fmt: skip


def parse(arguments: list[str] | None = None) -> Arguments:
    """The analysis and its options from the command line."""
    return tyro.extras.subcommand_cli_from_dict(ANALYSES, description=__doc__, args=arguments)


def main(arguments: Arguments) -> int:
    """Runs the analysis whose `arguments` they are; returns the exit code."""
    arguments.check()
    return arguments.run()


if __name__ == "__main__":
    run(main, parse)
