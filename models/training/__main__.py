"""`python -m models.training {cae,rnn,recall,probe}`: the trainings in their order, and a probe of the features."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from models.command_line import run
from models.errors import InputError


def parse(arguments: list[str] | None = None) -> Any:
    """The options of the command that was given."""
    import tyro

    from models.training.cae import CaeOptions
    from models.training.probe import ProbeOptions
    from models.training.recall import RecallOptions
    from models.training.rnn import RnnOptions

    commands: dict[str, Any] = {"cae": CaeOptions, "rnn": RnnOptions, "recall": RecallOptions, "probe": ProbeOptions}
    return tyro.extras.subcommand_cli_from_dict(
        commands, prog="python -m models.training", args=arguments, description=__doc__
    )


def main(options: Any) -> int:
    """Does what the options' command says; raises InputError for what cannot be used."""
    from models.training.cae import CaeOptions, train_cae
    from models.training.probe import ProbeOptions, run_probe
    from models.training.recall import RecallOptions, train_recall
    from models.training.rnn import RnnOptions, train_rnn

    does: dict[Any, Callable[[Any], Any]] = {
        CaeOptions: train_cae,
        RnnOptions: train_rnn,
        RecallOptions: train_recall,
        ProbeOptions: run_probe,
    }
    try:
        does[type(options)](options)
    except BrokenPipeError:
        raise
    except OSError as error:  # a folder that cannot be made, a disk that is full
        raise InputError(str(error)) from error
    return 0


if __name__ == "__main__":
    run(main, parse)
