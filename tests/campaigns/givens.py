"""What the programs of the campaigns are given: weights, data and a bench, small and made up."""

from pathlib import Path

from tests.campaigns.targets import swap, weights_of


def _make_bench(given: Path) -> None:
    """A finished bench of 12 episodes with the detectors off, for what is made of one."""
    from diagrams import bench
    from tests.diagrams.bench_fakes import bench_row

    swap("diagrams.bench", run_bench_task=bench_row)
    sizes = ["--episodes", "6", "--fit-runs", "2", "--calibration-runs", "2", "--workers", "0"]
    asked = [*weights_of(given), *sizes, "--detectors", "recall", "--faults", "A", "--out", f"{given}/bench"]
    if bench.main(bench.parse(asked)):
        raise RuntimeError("the bench that is exported could not be made")


def prepare(given: Path) -> None:
    """In a process of its own: weights and data that the programs are given."""
    import numpy as np

    from diagrams.world.configuration import World
    from models.data.recording import RecordingFile
    from models.files.graphs import write_graph
    from models.training.rnn import RnnOptions, train_rnn
    from tests.diagrams.teacher_fakes import recording
    from tests.diagrams.untrained import save_untrained
    from tests.models import handmade, synthetic

    (given / "weights").mkdir(parents=True)
    save_untrained(given / "weights")
    synthetic.write(given / "tiny.h5", grid=2, ticks=(48, 52))
    write_graph(given / "encoder.onnx", handmade.encoder().SerializeToString(), {"kind": "encoder", "metadata": {}})
    made = dict(data=given / "tiny.h5", encoder=given / "encoder.onnx", features=given / "features.npz", batch_size=4)
    found = train_rnn(RnnOptions(**made, out=given / "made", rnn="tests.models.outside:Elman", steps=8))  # type: ignore[arg-type]
    found.rename(given / "rnn-8.onnx")
    _make_bench(given)
    home = World().initial_posture
    with RecordingFile(given / "waving.h5", {"world": {}}, {"initial_posture": home, "period": 0.1}) as file:
        for index in range(4):
            rng = np.random.default_rng(index)
            wave = 0.1 * np.sin(0.1 * np.arange(60)[:, None] * rng.uniform(0.5, 1.5, 8))
            file.add(recording(index, 60, posture=home + wave + 0.001 * rng.normal(size=(60, 8))))
        file.finish([f"demo_{index}" for index in range(4)])
