"""Weight files: safetensors with JSON in the metadata; the large full layers in 8 bits a weight."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from models.data.scaling import MinMaxScaling
from models.errors import InputError
from models.networks.cae import ConvolutionalAutoencoder
from models.networks.recall import RecallHeads
from models.networks.rnn import RecurrentNetwork, make_rnn

FORMAT = 1
QUANTISE_FROM = 200_000  # a matrix with more weights than that is stored in 8 bits
_SCALE = ".row_scale"


class WeightsError(InputError):
    """A weight file is missing, damaged, or of another kind than asked for."""

    def __init__(self, path: str | Path, wrong: str, remedy: str) -> None:
        super().__init__(path, wrong, remedy)  # as they came, or no worker process could send the error back

    def __str__(self) -> str:
        path, wrong, remedy = self.args
        return f"{path}: {wrong}. {remedy}"


_RETRAIN = "Take the file from the repository again (git checkout), or train it with `python -m models.training`"


def quantise(weight: Tensor) -> tuple[Tensor, Tensor]:
    """W (rows, cols) float to int8 W and float32 scale (rows,), so that W is about int8 * scale: symmetric per row."""
    scale = weight.float().abs().amax(1).clamp_min(1e-12) / 127.0
    return torch.round(weight.float() / scale[:, None]).clamp_(-127, 127).to(torch.int8), scale


def dequantise(weight: Tensor, scale: Tensor) -> Tensor:
    """The float32 matrix that an int8 matrix (rows, cols) and its scale (rows,) stand for."""
    return weight.float() * scale[:, None]


def file_hash(path: str | Path) -> str:
    """SHA-256 of the file, hexadecimal."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError as error:
        raise WeightsError(path, "the weight file does not exist", _RETRAIN) from error
    except OSError as error:
        raise WeightsError(
            path, f"the weight file cannot be read ({error.strerror})", "Check its permissions"
        ) from error


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
        mean_errors: (N+1,) mean l_n of normal runs; reference_errors: (N+1,) what l_n is divided by; beta, gamma: of the detector's sigmoid.
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
        if value.ndim == 2 and value.numel() >= QUANTISE_FROM:
            tensors[name], tensors[name + _SCALE] = quantise(value)
        else:
            tensors[name] = value.to(torch.float16 if value.ndim > 1 else torch.float32).contiguous()
    header = {"kind": "autoencoder", "feature_activation": model.feature_activation, "metadata": metadata or {}}
    write_tensors(path, tensors, header)


def load_autoencoder(path: str | Path) -> tuple[ConvolutionalAutoencoder, dict[str, Any]]:
    """The autoencoder on its stored (dequantised) weights, in eval mode, and its metadata."""
    tensors, header = read_autoencoder(path)
    scales = {name: tensors.pop(name) for name in [n for n in tensors if n.endswith(_SCALE)]}
    state = {
        name: dequantise(value, scales[name + _SCALE]) if value.dtype == torch.int8 else value.float()
        for name, value in tensors.items()
    }
    try:
        model, metadata = ConvolutionalAutoencoder(header["feature_activation"]), header["metadata"]
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(path, f"its metadata does not describe an autoencoder ({error})", _RETRAIN) from error
    _fill(path, model, state)
    return model.eval(), metadata


def read_autoencoder(path: str | Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors as stored (NAME int8 with NAME.row_scale) and the header; checks kind and completeness."""
    tensors, header = read_tensors(path, "autoencoder")
    for name, value in tensors.items():
        scale, in_8_bits = tensors.get(name + _SCALE), value.dtype == torch.int8
        if in_8_bits and (scale is None or scale.shape != value.shape[:1]):
            raise WeightsError(path, f"its 8-bit layer {name} comes without a scale for each row", _RETRAIN)
        if not in_8_bits and value.ndim == 2 and value.numel() >= QUANTISE_FROM:
            raise WeightsError(path, f"its large layer {name} is stored as {value.dtype}, not in 8 bits", _RETRAIN)
    return tensors, header


def save_policy(path: str | Path, policy: StoredPolicy) -> None:
    """Writes network, heads (if any), scaling and calibration into one file; matrices float16, vectors float32."""
    parts: dict[str, nn.Module] = {"rnn": policy.rnn} | ({} if policy.recall is None else {"recall": policy.recall})
    tensors = {
        f"{part}.{name}": value.detach().cpu().to(torch.float16 if value.ndim > 1 else torch.float32).contiguous()
        for part, module in parts.items()
        for name, value in module.state_dict().items()
    }
    header = {
        "kind": "policy",
        "rnn": policy.rnn.name,
        "posture_size": policy.rnn.posture_size,
        "feature_size": policy.rnn.feature_size,
        "encoder_hash": policy.encoder_hash,
        "recall": None if policy.recall is None else {"horizon": policy.recall.horizon, "hidden": policy.recall.hidden},
        "lower": policy.scaling.lower.tolist(),
        "upper": policy.scaling.upper.tolist(),
        "initial_posture": np.asarray(policy.initial_posture, float).tolist(),
        "regulator_gain": float(policy.regulator_gain),
        "mean_errors": _numbers(policy.mean_errors),
        "reference_errors": _numbers(policy.reference_errors),
        "beta": policy.beta,
        "gamma": policy.gamma,
        "metadata": policy.metadata,
    }
    write_tensors(path, tensors, header)


def load_policy(path: str | Path) -> StoredPolicy:
    """Reads what save_policy wrote; networks in eval mode."""
    tensors, header = read_tensors(path, "policy")
    try:
        rnn = make_rnn(header["rnn"], header["posture_size"], header["feature_size"])
        recall = None
        if header["recall"] is not None:
            recall = RecallHeads(rnn.state_size, rnn.posture_size, **header["recall"])
        policy = StoredPolicy(
            rnn=rnn.eval(),
            recall=recall,
            scaling=MinMaxScaling(header["lower"], header["upper"]),
            initial_posture=np.array(header["initial_posture"], float),
            regulator_gain=float(header["regulator_gain"]),
            encoder_hash=header["encoder_hash"],
            mean_errors=_array(header["mean_errors"]),
            reference_errors=_array(header.get("reference_errors")),
            beta=header["beta"],
            gamma=header["gamma"],
            metadata=header["metadata"],
        )
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(path, f"its metadata does not describe a policy ({error})", _RETRAIN) from error
    _fill(path, rnn, _part(tensors, "rnn."))
    if recall is not None:
        _fill(path, recall.eval(), _part(tensors, "recall."))
    return policy


def _numbers(vector: np.ndarray | None) -> list[float] | None:
    return None if vector is None else np.asarray(vector, float).tolist()


def _array(numbers: list[float] | None) -> np.ndarray | None:
    return None if numbers is None else np.array(numbers)


def _part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name[len(prefix) :]: value for name, value in tensors.items() if name.startswith(prefix)}


def write_tensors(path: str | Path, tensors: dict[str, Tensor], header: dict[str, Any]) -> None:
    """Writes tensors and a JSON-serialisable header with its `kind`; the file appears under its name only when it is whole."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    # One string: safetensors writes several in random order, and the same content would get another hash each time.
    save_file(tensors, partial, {"header": json.dumps({"format": FORMAT} | header, sort_keys=True)})
    partial.chmod(0o644)
    os.replace(partial, path)  # a killed training never leaves half a file under the real name


def read_tensors(path: str | Path, kind: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """What write_tensors wrote; raises WeightsError unless the file is there, whole, finite and of that kind."""
    if not Path(path).is_file():
        raise WeightsError(path, "the weight file does not exist", _RETRAIN)
    try:
        with safe_open(path, "pt") as file:
            header = dict(json.loads((file.metadata() or {}).get("header", "{}")))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError, TypeError, ValueError) as error:
        raise WeightsError(path, f"the weight file is damaged ({error})", _RETRAIN) from error
    if header.get("format") != FORMAT or header.get("kind") != kind:
        raise WeightsError(
            path,
            f"is a file of kind {header.get('kind')!r}, format {header.get('format')!r}, "
            f"where kind {kind!r}, format {FORMAT} is needed",
            "Give the file that was meant",
        )
    if any(not torch.isfinite(value.float()).all() for value in tensors.values() if value.is_floating_point()):
        raise WeightsError(path, "holds weights that are not finite", _RETRAIN)
    return tensors, header


def _fill(path: str | Path, module: nn.Module, state: dict[str, Tensor]) -> None:
    own = module.state_dict()
    state = state | {name: value for name, value in own.items() if name.endswith("num_batches_tracked")}
    bad = sorted(own.keys() ^ state.keys()) + sorted(
        n for n in own.keys() & state.keys() if own[n].shape != state[n].shape
    )
    if bad:
        raise WeightsError(path, f"does not fit the network at {', '.join(bad[:4])}", _RETRAIN)
    module.load_state_dict(state)
