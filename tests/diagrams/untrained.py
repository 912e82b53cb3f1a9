"""Weight files of networks that learned nothing, for tests of the programs around them."""

import functools
import tempfile
from pathlib import Path

import numpy as np
import torch

from diagrams.world.configuration import World
from models.data.scaling import MinMaxScaling
from models.files.container import file_hash
from models.files.graphs import write_graph
from models.files.weights import StoredPolicy, save_policy
from models.networks.recall import RecallHeads
from models.networks.rnn import make_rnn
from tests.models import handmade


@functools.cache
def _untrained_policy(calibrated: bool, encoder_hash: str, gamma: float) -> bytes:
    """The content of the file: exported once for all tests of a process."""
    torch.manual_seed(0)
    rnn, posture = make_rnn("lstm"), World().initial_posture
    reach = np.append(np.full(7, 1.0), 0.06)
    policy = StoredPolicy(
        rnn=rnn, recall=RecallHeads(rnn.state_size, 8), name="lstm",
        scaling=MinMaxScaling(posture - reach, posture + reach),
        initial_posture=posture, metadata={"training": {"seed": 0}}, encoder_hash=encoder_hash,
        mean_errors=np.full(11, 1e-9) if calibrated else None,
        beta=30.0 if calibrated else None, gamma=gamma if calibrated else None,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        save_policy(Path(folder, "lstm.onnx"), policy)
        return Path(folder, "lstm.onnx").read_bytes()


def save_untrained(folder: Path, calibrated: bool = True, encoder_hash: str | None = None, gamma: float = 10.0) -> Path:
    """Writes encoder.onnx, decoder.onnx and lstm.onnx into `folder`; the detector notices everything."""
    for name, graph in (("encoder", handmade.encoder()), ("decoder", handmade.decoder())):
        write_graph(folder / f"{name}.onnx", graph.SerializeToString(), {"kind": name, "metadata": {}})
    encoder_hash = encoder_hash or file_hash(folder / "encoder.onnx")
    (folder / "lstm.onnx").write_bytes(_untrained_policy(calibrated, encoder_hash, gamma))
    return folder
