"""Small valid files of every kind, which the campaign's inputs are made from."""

import json
import os
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from diagrams import bench, sweep
from diagrams.episodes import compatibility
from diagrams.episodes.episode import Outcome
from diagrams.episodes.fingerprint import fingerprint
from diagrams.episodes.record import save_record
from diagrams.episodes.store import RowStore
from diagrams.hybrid.cycle_sweep import DRAWN
from diagrams.monitors import export
from diagrams.sweeps.plan import plan
from diagrams.sweeps.table import write_table
from diagrams.world.configuration import World
from models.data.lerobot import LeRobotFolder
from models.data.recording import RecordingFile
from models.files.container import file_hash
from models.files.detectors import StoredDetector, save_detector
from models.files.graphs import write_graph
from models.files.policies import PolicyFacts, write_policy
from models.files.weights import save_autoencoder
from models.networks.cae import ConvolutionalAutoencoder
from models.training.__main__ import main as train
from models.training.__main__ import parse as parse_training
from systems.detectors import DETECTORS
from tests.diagrams import bench_fakes
from tests.diagrams.hybrid.test_cycle import CALM, RESUMED, RETURNED
from tests.diagrams.recorded_run import recorded_run
from tests.diagrams.sweep_fakes import outcome_row
from tests.models import handmade, synthetic

HORIZON = 10
SWEEP = ["--episodes", "2", "--disturbance", "A", "--workers", "1"]  # whose rows lie in sweep/
BENCH = [
    "--weights", "weights", "--detectors", "recall", "knn", "mahalanobis", "--faults", "A", "--episodes", "1",
    "--fit-runs", "2", "--calibration-runs", "2", "--workers", "1",
]  # fmt: skip
OFFLINE = ["--detectors", "speed", "--seed", "1", "--out", "out"]
RNN = [
    "rnn", "--data", "demos.h5", "--encoder", "weights/encoder.onnx", "--out", "out", "--rnn",
    "tests.models.outside:Elman",
    "--steps", "4", "--batch-size", "2", "--checkpoint-every", "2", "--validate-every", "2",
]  # fmt: skip
CAE = [
    "cae", "--data", "demos.h5", "--out", "out", "--max-images", "8", "--batch-size", "2", "--checkpoint-every", "2",
]  # fmt: skip
RECALL = [
    "recall", "--policy", "rnn-4.onnx", "--data", "demos.h5", "--encoder", "weights/encoder.onnx", "--out", "out",
    "--steps", "4", "--batch-size", "2", "--hidden", "4", "--horizon", "3",
]  # fmt: skip


@dataclass(frozen=True)
class Bases:
    """Contents by the names that the cases give them."""

    weights: dict[str, bytes]  # weights/NAME
    demos: bytes
    candidate: bytes  # rnn-4.onnx of `training rnn`
    policy: bytes  # policy-4.onnx of `training recall`
    trainings: dict[str, dict[str, bytes]]  # broken off, by what they train: out/NAME
    autoencoder: bytes
    record: bytes
    sweep: dict[str, bytes]
    bench: dict[str, bytes]  # NAME in a bench that is done
    export: dict[str, bytes]  # out/NAME of what is exported of it
    runs: dict[str, bytes]  # of ten, in both layouts: lerobot/NAME and robomimic.hdf5
    reports: dict[str, bytes]  # out/NAME.json and the sweep for `analysis cycle`

    def write_weights(self, names: tuple[str, ...] = ()) -> dict[str, bytes]:
        """The files of a folder `weights`, all or those named."""
        return {f"weights/{name}": self.weights[name] for name in names or self.weights}


def make_bases() -> Bases:
    """Makes them, in a scratch folder; takes some seconds."""
    before, folder = Path.cwd(), Path(tempfile.mkdtemp())
    os.chdir(folder)
    try:
        return _make(folder)
    finally:
        os.chdir(before)
        shutil.rmtree(folder)


def _make(folder: Path) -> Bases:
    torch.manual_seed(0)
    world, weights = World(), folder / "weights"
    weights.mkdir()
    for name, graph in (("encoder", handmade.encoder()), ("decoder", handmade.decoder())):
        write_graph(weights / f"{name}.onnx", graph.SerializeToString(), {"kind": name, "metadata": {}})
    posture = world.initial_posture
    synthetic.INITIAL_POSTURE, synthetic.WORLD = posture, compatibility.facts(world)  # so that the networks fit it
    facts = PolicyFacts(
        name="lstm", scaling=_scaling(posture), initial_posture=posture,
        encoder_hash=file_hash(weights / "encoder.onnx"), mean_errors=np.ones(HORIZON + 1), beta=30.0, gamma=10.0,
    )  # fmt: skip
    write_policy(weights / "lstm.onnx", facts, handmade.policy(None, horizon=HORIZON).SerializeToString())
    runs = [np.cumsum(np.random.default_rng(n).normal(size=(60, 7)), axis=0) * 0.01 for n in range(3)]
    policy_hash = file_hash(weights / "lstm.onnx")
    for name in ("knn", "subspace"):
        calibration = {"mean_errors": [1.0] * 7, "beta": 30.0, "gamma": 5.0}
        stored = StoredDetector(name, DETECTORS[name].fit(runs), {policy_hash: calibration}, {"data": "none"})
        save_detector(weights / f"{name}.safetensors", stored)
    synthetic.write(folder / "demos.h5", grid=2, ticks=(30, 32))
    save_autoencoder(folder / "cae.safetensors", ConvolutionalAutoencoder(), {"data_hash": "abc"})
    train(parse_training(RNN))
    (folder / "out" / "rnn-4.onnx").rename(folder / "rnn-4.onnx")
    train(parse_training(RECALL))
    policy = (folder / "out" / "policy-4.onnx").read_bytes()
    shutil.rmtree(folder / "out")
    trainings = {}
    for argv, length, whole in ((CAE, "max_images", 8), (RNN, "steps", 4), (RECALL, "steps", 4)):
        train(parse_training([*argv, f"--{length.replace('_', '-')}", str(whole // 2)]))
        _relabel(next((folder / "out").glob("*.ckpt")), length, whole)
        left = (path for path in sorted((folder / "out").iterdir()) if path.suffix not in (".onnx", ".safetensors"))
        trainings[argv[0]] = {f"out/{path.name}": path.read_bytes() for path in left}
        shutil.rmtree(folder / "out")
    values = dict.fromkeys(Outcome.__dataclass_fields__)
    values |= {"seed": 3, "disturbance": "B", "detector": "recall", "success": True, "switch_success": True}
    save_record(folder / "B.npz", recorded_run(60), Outcome(**(values | {"weights_hash": policy_hash})))
    return Bases(
        weights={path.name: path.read_bytes() for path in sorted(weights.iterdir())},
        demos=(folder / "demos.h5").read_bytes(),
        candidate=(folder / "rnn-4.onnx").read_bytes(),
        policy=policy,
        trainings=trainings,
        autoencoder=(folder / "cae.safetensors").read_bytes(),
        record=(folder / "B.npz").read_bytes(),
        sweep=_sweep(folder),
        bench=_bench(folder),
        export=_export(folder),
        runs=_runs(folder),
        reports=_reports(folder),
    )


def _scaling(posture: np.ndarray):
    from models.data.scaling import MinMaxScaling

    return MinMaxScaling(posture - 1.0, posture + 1.0)


def _relabel(path: Path, length: str, whole: int) -> None:
    """A checkpoint of a short training, as if of a longer one that was broken off."""
    stored = torch.load(path, weights_only=True)
    stored["made_with"][length] = whole
    torch.save(stored, path)


def _sweep(folder: Path) -> dict[str, bytes]:
    arguments = sweep.parse(["--weights", "weights", *SWEEP])
    tasks, _ = plan(arguments, World())
    rows = [outcome_row(folder, task) | {"wall_seconds": 1.0, "realtime_factor": 2.0} for task in tasks]
    out = folder / "sweep"
    with RowStore(out / "rows.jsonl", fingerprint(World())) as store:
        for task, row in zip(tasks, rows, strict=True):
            store.add(task.key, row)
    write_table(out, rows)
    (out / "summary.json").write_text("{}\n")
    return {path.name: path.read_bytes() for path in out.iterdir()}


def _bench(folder: Path) -> dict[str, bytes]:
    out = folder / "bench"
    bench.run_bench_task = bench_fakes.bench_row
    bench_fakes.SIZES["hidden_state"] = (8 * HORIZON,)  # of the handmade network
    if bench.main(bench.parse([*BENCH, "--workers", "0", "--out", str(out)])):
        raise RuntimeError("the bench that the inputs are made from could not be made")
    return _contents(out)


def _contents(folder: Path, prefix: str = "") -> dict[str, bytes]:
    """Of all files in it, by their names there."""
    return {f"{prefix}{path.relative_to(folder)}": path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _export(folder: Path) -> dict[str, bytes]:
    out = folder / "export"
    export.record_run = lambda _, job: bench_fakes.recorded(job.name, key=job.task.key)
    if export.Export(out, bench=folder / "bench", workers=0).run():
        raise RuntimeError("the bench that the inputs are made from could not be exported")
    return _contents(out, "out/")


def _runs(folder: Path) -> dict[str, bytes]:
    out, given = folder / "runs", ({"made": "up"}, compatibility.of_data_sets(World()))
    runs = [bench_fakes.recorded(f"demo_{i}", success=i < 9) for i in range(10)]
    with RecordingFile(out / export.ROBOMIMIC, *given) as file, LeRobotFolder(out / export.LEROBOT, *given) as lerobot:
        for layout in (file, lerobot):
            for run in runs:
                layout.add(run)
            layout.finish([run.name for run in runs])
    return _contents(out)


def _reports(folder: Path) -> dict[str, bytes]:
    import pandas as pd

    own, out = fingerprint(World()), folder / "reports"
    with RowStore(out / "rows.jsonl", own):
        pass
    pd.DataFrame([{"can_xy": [0.5, 0.0]} | one for one in CALM]).to_parquet(out / "episodes.parquet")
    (out / "summary.json").write_text(json.dumps({"arguments": DRAWN}))
    reports = {"out/return.json": RETURNED, "out/resume.json": RESUMED}
    found = {name: json.dumps(content | {"fingerprint": own}).encode() for name, content in reports.items()}
    return found | {f"sweep/{path.name}": path.read_bytes() for path in out.iterdir()}
