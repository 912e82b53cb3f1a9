"""`python -m models.training {cae,rnn,recall} --data FILE.h5 --out DIR`: the three trainings in their order."""

from __future__ import annotations

import sys
from typing import Any


def main(arguments: list[str] | None = None) -> int:
    """Parses the command line and trains. Exit code 2: bad input, one clear line."""
    import tyro

    from models.training.cae import CaeOptions, train_cae
    from models.training.recall import RecallOptions, train_recall
    from models.training.rnn import RnnOptions, train_rnn

    commands: dict[str, Any] = {"cae": CaeOptions, "rnn": RnnOptions, "recall": RecallOptions}
    options = tyro.extras.subcommand_cli_from_dict(commands, args=arguments, description=__doc__)
    train: Any = {CaeOptions: train_cae, RnnOptions: train_rnn, RecallOptions: train_recall}[type(options)]
    try:
        train(options)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
