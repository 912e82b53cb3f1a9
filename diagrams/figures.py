"""Figures 4 to 7 of the paper, and switching success against gamma.

    python diagrams/figures.py --records outputs/sweep/records --sweep outputs/sweep_gamma

Fig. 4 is drawn from the weight files. Figs. 5 to 7 are drawn from records (of pick_place.py --record or sweep.py
--keep-records), one for each disturbance: the first in which all went well, under B one in which the can was taken from
the hand. The curve of gamma is drawn from a sweep with several values of --gamma.
Exit code 2: bad input.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tyro

from diagrams.episodes.record import Record
from diagrams.world.configuration import World
from diagrams.world.names import DECODER, ENCODER, WEIGHTS
from diagrams.world.scenario import load_world
from models.command_line import require, require_writable, run
from models.networks import NETWORKS, network_label


@dataclass
class FiguresArguments:
    """What the figures are drawn from, and where they go."""

    records: list[Path] = field(default_factory=list)  # files, or folders of them
    sweep: list[Path] = field(default_factory=list)  # folders of sweeps with several values of --gamma
    rnn: str = "lstm"  # whose records are shown
    training_seed: int = 0
    weights: Path = WEIGHTS  # folder of the trained networks
    world: Path | None = None  # YAML file of the world that the records were made in
    out: Path = Path("outputs/figures")


def parse(arguments: list[str] | None = None) -> FiguresArguments:
    """The command line."""
    return tyro.cli(FiguresArguments, args=arguments, description=__doc__)


def main(arguments: FiguresArguments) -> int:
    """Writes the figures that there is something for, and their numbers as figures.json; returns the exit code."""
    require("pandas", "pyarrow", "scipy", "sklearn")
    from diagrams.drawing.paper_figures import save_gamma_curve, save_recall_loss
    from diagrams.episodes.calibration import policy_file
    from diagrams.episodes.figure_numbers import choose_records, recall_losses
    from diagrams.sweeps.gamma import gamma_curves
    from diagrams.sweeps.table import read_tables
    from models.files.policies import read_policy

    out, rnn, world = arguments.out, network_label(arguments.rnn), load_world(arguments.world)
    path = policy_file(arguments.weights, arguments.rnn, arguments.training_seed)
    notes: dict[str, Any] = {"rnn": rnn, "weights_hash": read_policy(path)[1].hash}
    chosen = choose_records(arguments.records, notes["weights_hash"]) if arguments.records else {}
    curves, bounds = gamma_curves(read_tables(arguments.sweep)) if arguments.sweep else ({}, {})
    require_writable(out / "figures.json")
    written = []
    if losses := recall_losses(arguments.weights):
        written.append(out / "fig4_recall_loss.png")
        save_recall_loss(losses, written[-1])
        notes["recall_loss"] = {name: values.tolist() for name, values in losses.items()}
    for absent in NETWORKS:
        if absent not in losses:
            print(f"Fig. 4: {absent} has no calibrated weights in {arguments.weights}: left out")
    if chosen:
        written += draw_runs(chosen, world, arguments.weights, out, notes)
    else:
        print("no --records: Figs. 5 to 7 are left out")
    if curves:
        written.append(out / "gamma.png")
        save_gamma_curve(curves, bounds, written[-1])
        notes["gamma"] = curves
    else:
        print("no --sweep with several values of --gamma: its curve is left out")
    written.append(out / "figures.json")
    written[-1].write_text(json.dumps(notes, indent=1) + "\n")
    print(f"written: {', '.join(map(str, written))}")
    return 0


def draw_runs(
    chosen: dict[str, tuple[Record, dict]], world: World, weights: Path, out: Path, notes: dict[str, Any]
) -> list[Path]:
    """Figs. 5 to 7 of the records and outcomes `chosen`, by their disturbance; returns what is written."""
    from diagrams.drawing.paper_figures import save_reconstructions, save_states
    from diagrams.drawing.timeline import save_sequences
    from diagrams.episodes.figure_numbers import principal_states, reconstructions
    from models.inference import Decoder, Encoder

    notes["episodes"] = {kind: outcome for kind, (_, outcome) in chosen.items()}
    for kind, outcome in notes["episodes"].items():
        word = "done" if outcome["success"] else f"failed ({outcome['failure']})"
        print(f"disturbance {kind}: episode {outcome['seed']}, task {word}", flush=True)
    titles = {"none": "no disturbance", "A": "disturbance A", "B": "disturbance B"}
    records = {titles[kind]: record for kind, (record, _) in chosen.items()}
    written = [out / "fig5_sequences.png", out / "fig7_states.png"]
    save_sequences(records, written[0])
    if {"none", "B"} <= set(chosen):  # these are compared in the paper
        records.pop(titles["A"], None)
    states, origin, ratios = principal_states(records, world)
    save_states(states, origin, ratios, written[1])
    notes["contribution_ratios"] = ratios.tolist()
    shares = ", ".join(f"PC{i + 1} {100 * share:.1f} %" for i, share in enumerate(ratios))
    print(f"contribution ratios of the hidden states: {shares}")
    title, record = list(records.items())[-1]
    if len(record.pictures):
        written.append(out / "fig6_reconstructions.png")
        coders = Encoder(weights / ENCODER).encode, Decoder(weights / DECODER).decode
        save_reconstructions(reconstructions(record, *coders), written[-1])
    else:
        print(f"Fig. 6: the record of {title} holds no pictures: left out")
    return sorted(written)


if __name__ == "__main__":
    run(main, parse)
