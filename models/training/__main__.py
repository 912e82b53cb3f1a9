"""`python -m models.training {cae,export,rnn,recall,probe}`: the steps in their order, and a probe of the features."""

from collections.abc import Callable
from typing import Any

from models.command_line import run
from models.errors import InputError


def commands() -> dict[str, tuple[Any, Callable[[Any], Any]]]:
    """By the command's name: its options, and what does it."""
    from models.training.cae import CaeOptions, train_cae
    from models.training.export import ExportOptions, export
    from models.training.probe import ProbeOptions, run_probe
    from models.training.recall import RecallOptions, train_recall
    from models.training.rnn import RnnOptions, train_rnn

    return {
        "cae": (CaeOptions, train_cae),
        "export": (ExportOptions, export),
        "rnn": (RnnOptions, train_rnn),
        "recall": (RecallOptions, train_recall),
        "probe": (ProbeOptions, run_probe),
    }


def parse(arguments: list[str] | None = None) -> Any:
    """The options of the command that was given."""
    import tyro

    options = {name: options for name, (options, _) in commands().items()}
    return tyro.extras.subcommand_cli_from_dict(
        options, prog="python -m models.training", args=arguments, description=__doc__
    )


def main(options: Any) -> int:
    """Does what the options' command says; raises InputError for what cannot be used."""
    try:
        next(command for kind, command in commands().values() if type(options) is kind)(options)
    except BrokenPipeError:
        raise
    except OSError as error:  # a folder that cannot be made, a disk that is full
        raise InputError(f"{error}: choose another place, or make room") from error
    return 0


if __name__ == "__main__":
    run(main, parse)
