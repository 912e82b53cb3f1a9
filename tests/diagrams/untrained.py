"""Weight files of networks that learned nothing, for tests of the programs around them."""

from pathlib import Path

import numpy as np
import torch

from diagrams.world.configuration import World
from models.data.scaling import MinMaxScaling
from models.files.weights import StoredPolicy, file_hash, save_autoencoder, save_policy
from models.networks.cae import ConvolutionalAutoencoder
from models.networks.recall import RecallHeads
from models.networks.rnn import make_rnn

GAIN = 0.1  # the LQR's, of weights 1 and 90


def save_untrained(folder: Path, calibrated: bool = True, encoder_hash: str | None = None, gain: float = GAIN) -> Path:
    """Writes cae.safetensors and lstm.safetensors into `folder`; the detector notices everything."""
    torch.manual_seed(0)
    save_autoencoder(folder / "cae.safetensors", ConvolutionalAutoencoder(), {})
    rnn, posture = make_rnn("lstm"), World().initial_posture
    reach = np.append(np.full(7, 1.0), 0.06)
    policy = StoredPolicy(
        rnn=rnn, recall=RecallHeads(rnn.state_size, 8), scaling=MinMaxScaling(posture - reach, posture + reach),
        initial_posture=posture, regulator_gain=gain, metadata={"training": {"seed": 0}},
        encoder_hash=encoder_hash or file_hash(folder / "cae.safetensors"),
        mean_errors=np.full(11, 1e-9) if calibrated else None,
        reference_errors=np.full(11, 1e-9) if calibrated else None,
        beta=30.0 if calibrated else None, gamma=10.0 if calibrated else None,
    )  # fmt: skip
    save_policy(folder / "lstm.safetensors", policy)
    return folder
