"""Analyses the switched controller as one hybrid system.

    python diagrams/analysis.py {modes,return,linearize,guard,falsify,states} --out DIR

Each writes DIR/NAME.json and its pictures beside it. Exit code 0: what it checks holds; 1: it does not; 2: bad input.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import tyro

from diagrams.hybrid import falsification, guard, modes, return_certificate, states, switching_point
from diagrams.hybrid.common import Arguments
from models.command_line import run

ANALYSES: dict[str, tuple[type[Arguments], Callable[[Any], int]]] = {
    "modes": (modes.Modes, modes.run),
    "return": (return_certificate.Return, return_certificate.run),
    "linearize": (switching_point.Linearize, switching_point.run),
    "guard": (guard.Guard, guard.run),
    "falsify": (falsification.Falsify, falsification.run),
    "states": (states.States, states.run),
}


def parse(arguments: list[str] | None = None) -> Arguments:
    """The analysis and its options from the command line."""
    choices: dict[str, Callable[..., Arguments]] = {name: kind for name, (kind, _) in ANALYSES.items()}
    return tyro.extras.subcommand_cli_from_dict(choices, description=__doc__, args=arguments)


def main(arguments: Arguments) -> int:
    """Runs the analysis whose `arguments` they are; returns the exit code."""
    import torch

    torch.set_num_threads(1)  # fastest at batch 1, and the sums of every evaluation
    arguments.check()
    return next(analyse for kind, analyse in ANALYSES.values() if kind is type(arguments))(arguments)


if __name__ == "__main__":
    run(main, parse)
