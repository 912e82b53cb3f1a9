"""Weight files of the autoencoder and of the policies."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from models.data.scaling import MinMaxScaling
from models.errors import InputError
from models.files.quantisation import SCALE, dequantise, is_large, quantise, rounded
from models.files.tensors import RETRAIN, WeightsError, read_tensors, write_tensors
from models.files.tensors import file_hash as file_hash
from models.networks.cae import ConvolutionalAutoencoder
from models.networks.recall import RecallHeads
from models.networks.rnn import RecurrentNetwork, make_rnn

# Fields of a StoredPolicy that the header holds under their own names.
_PLAIN = ("regulator_gain", "encoder_hash", "beta", "gamma", "metadata")
_VECTORS = ("initial_posture", "mean_errors", "reference_errors")


@dataclass
class StoredPolicy:
    """What a policy file holds; postures in physical units (rad, m), what the calibration gives None before it.

    Attributes:
        rnn: the recurrent network.
        recall: recall heads, None in a candidate that was not through `training recall`.
        scaling: bounds of the posture (8,).
        initial_posture: (8,).
        regulator_gain: K per tick, the same for each joint.
        encoder_hash: file hash of the autoencoder whose features it was trained on.
        mean_errors: (N+1,) mean l_n of normal runs; reference_errors: (N+1,) what l_n is divided by.
        beta, gamma: of the detector's sigmoid.
        metadata: anything else, JSON-serialisable: training arguments, hash of the data set.
    """

    rnn: RecurrentNetwork
    recall: RecallHeads | None
    scaling: MinMaxScaling
    initial_posture: np.ndarray
    regulator_gain: float
    encoder_hash: str
    mean_errors: np.ndarray | None = None
    reference_errors: np.ndarray | None = None
    beta: float | None = None
    gamma: float | None = None
    metadata: dict[str, Any] = field(default_factory=dict)


def save_autoencoder(path: str | Path, model: ConvolutionalAutoencoder, metadata: dict[str, Any] | None = None) -> None:
    """Writes the autoencoder: large full layers int8, other matrices float16, vectors float32."""
    tensors: dict[str, Tensor] = {}
    for name, value in model.state_dict().items():
        value = value.detach().cpu()
        if name.endswith("num_batches_tracked"):
            continue  # counts training steps, nothing that is evaluated
        if is_large(value):
            tensors[name], tensors[name + SCALE] = quantise(value)
        else:
            tensors[name] = rounded(value)
    header = {"kind": "autoencoder", "feature_activation": model.feature_activation, "metadata": metadata or {}}
    write_tensors(path, tensors, header)


def load_autoencoder(path: str | Path) -> tuple[ConvolutionalAutoencoder, dict[str, Any]]:
    """The autoencoder on its stored (dequantised) weights, in eval mode, and its metadata."""
    tensors, header = read_autoencoder(path)
    state = {
        name: dequantise(value, tensors[name + SCALE]) if value.dtype == torch.int8 else value.float()
        for name, value in tensors.items()
        if not name.endswith(SCALE)
    }
    try:
        model, metadata = ConvolutionalAutoencoder(header["feature_activation"]), header["metadata"]
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(path, f"its metadata does not describe an autoencoder ({error})", RETRAIN) from error
    _fill(path, model, state)
    return model.eval(), metadata


def read_autoencoder(path: str | Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors as stored (NAME int8 with NAME.row_scale) and the header; checks kind and completeness."""
    tensors, header = read_tensors(path, "autoencoder")
    for name, value in tensors.items():
        scale, in_8_bits = tensors.get(name + SCALE), value.dtype == torch.int8
        if in_8_bits and (scale is None or scale.shape != value.shape[:1]):
            raise WeightsError(path, f"its 8-bit layer {name} comes without a scale for each row", RETRAIN)
        if not in_8_bits and is_large(value):
            raise WeightsError(path, f"its large layer {name} is stored as {value.dtype}, not in 8 bits", RETRAIN)
    return tensors, header


def save_policy(path: str | Path, policy: StoredPolicy) -> None:
    """Writes network, heads (if any), scaling and calibration into one file; matrices float16, vectors float32."""
    parts: dict[str, nn.Module] = {"rnn": policy.rnn} | ({} if policy.recall is None else {"recall": policy.recall})
    tensors = {
        f"{part}.{name}": rounded(value.detach().cpu())
        for part, module in parts.items()
        for name, value in module.state_dict().items()
    }
    header = {
        "kind": "policy",
        "rnn": policy.rnn.spec,
        "posture_size": policy.rnn.posture_size,
        "feature_size": policy.rnn.feature_size,
        "recall": None if policy.recall is None else {"horizon": policy.recall.horizon, "hidden": policy.recall.hidden},
        "lower": policy.scaling.lower.tolist(),
        "upper": policy.scaling.upper.tolist(),
    }
    header |= {name: getattr(policy, name) for name in _PLAIN + _VECTORS}
    write_tensors(path, tensors, header)


def load_policy(path: str | Path) -> StoredPolicy:
    """Reads what save_policy wrote; networks in eval mode."""
    tensors, header = read_tensors(path, "policy")
    try:
        rnn = make_rnn(header["rnn"], header["posture_size"], header["feature_size"])
        heads = header["recall"]
        recall = None if heads is None else RecallHeads(rnn.state_size, rnn.posture_size, **heads)
        stored = {name: header[name] for name in _PLAIN}
        stored |= {name: None if header[name] is None else np.array(header[name]) for name in _VECTORS}
        policy = StoredPolicy(rnn.eval(), recall, MinMaxScaling(header["lower"], header["upper"]), **stored)
    except InputError as error:
        raise WeightsError(path, f"its network cannot be built ({error})", "Install what defines it") from error
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(path, f"its metadata does not describe a policy ({error})", RETRAIN) from error
    _fill(path, rnn, _part(tensors, "rnn."))
    if recall is not None:
        _fill(path, recall.eval(), _part(tensors, "recall."))
    return policy


def _part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name[len(prefix) :]: value for name, value in tensors.items() if name.startswith(prefix)}


def _fill(path: str | Path, module: nn.Module, state: dict[str, Tensor]) -> None:
    try:
        module.load_state_dict(state)
    except RuntimeError as error:
        raise WeightsError(path, f"does not fit the network ({' '.join(str(error).split())[:200]})", RETRAIN) from error
