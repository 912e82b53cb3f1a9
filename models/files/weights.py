"""The torch side of the weight files: what trainings write, and go on from."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from models.errors import InputError
from models.files.container import RETRAIN, WeightsError
from models.files.graphs import weights_of
from models.files.policies import PolicyFacts, read_policy, write_policy
from models.files.tensors import read_tensors, write_tensors
from models.networks.cae import ConvolutionalAutoencoder
from models.networks.recall import RecallHeads
from models.networks.rnn import RecurrentNetwork, make_rnn


@dataclass(kw_only=True)
class StoredPolicy(PolicyFacts):
    """A policy file with its torch modules.

    Attributes:
        rnn: the recurrent network.
        recall: recall heads, None in a candidate that was not through `training recall`.
    """

    rnn: RecurrentNetwork
    recall: RecallHeads | None = None


def save_autoencoder(path: str | Path, model: ConvolutionalAutoencoder, metadata: dict[str, Any] | None = None) -> None:
    """Writes the autoencoder for `training export`: matrices float16, vectors float32."""
    arrays = {
        name: value.detach().cpu().to(torch.float16 if value.ndim > 1 else torch.float32).numpy()
        for name, value in model.state_dict().items()
        if not name.endswith("num_batches_tracked")  # counts training steps, nothing that is evaluated
    }
    header = {"kind": "autoencoder", "feature_activation": model.feature_activation, "metadata": metadata or {}}
    write_tensors(path, arrays, header)


def load_autoencoder(path: str | Path) -> tuple[ConvolutionalAutoencoder, dict[str, Any]]:
    """The autoencoder on its stored weights, in eval mode, and its metadata."""
    arrays, header = read_tensors(path, "autoencoder", RETRAIN)
    try:
        model, metadata = ConvolutionalAutoencoder(header["feature_activation"]), header["metadata"]
        if not isinstance(metadata, dict):
            raise ValueError(f"metadata is {metadata!r:.60}")
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(path, f"its metadata does not describe an autoencoder ({error})", RETRAIN) from error
    _fill(path, model, {name: torch.from_numpy(value).float() for name, value in arrays.items()})
    return model.eval(), metadata


def save_policy(path: str | Path, policy: StoredPolicy) -> None:
    """Writes network, heads (if any), scaling and calibration into one file that runs; matrices float16."""
    from models.networks.onnx_export import policy_graph

    heads = policy.recall
    policy.torch = {"rnn": policy.rnn.spec, "posture_size": policy.rnn.posture_size}
    policy.torch |= {"feature_size": policy.rnn.feature_size, "recall": None}
    if heads is not None:
        policy.torch["recall"] = {"horizon": heads.horizon, "hidden": heads.hidden}
    write_policy(path, policy, policy_graph(policy.rnn, heads))


def load_policy(path: str | Path) -> StoredPolicy:
    """Reads what save_policy wrote; networks in eval mode. Raises WeightsError for a graph that torch did not make."""
    facts, graph = read_policy(path)
    if (given := facts.torch) is None:
        raise WeightsError(path, "was not made by torch here", "Give a file that `python -m models.training` wrote")
    try:
        rnn = make_rnn(given["rnn"], given["posture_size"], given["feature_size"])
        heads = given["recall"]
        recall = None if heads is None else RecallHeads(rnn.state_size, rnn.posture_size, **heads)
    except InputError as error:
        raise WeightsError(path, f"its network cannot be built ({error})", "Install what defines it") from error
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(path, f"its header does not describe a policy ({error})", RETRAIN) from error
    weights = {name: torch.from_numpy(value) for name, value in weights_of(graph).items()}
    for part, module in (("rnn.", rnn), ("recall.", recall)):
        if module is not None:
            _fill(path, module.eval(), {name[len(part) :]: w for name, w in weights.items() if name.startswith(part)})
    return StoredPolicy(rnn=rnn, recall=recall, **vars(facts))


def _fill(path: str | Path, module: nn.Module, state: dict[str, Tensor]) -> None:
    try:
        module.load_state_dict(state)
    except RuntimeError as error:
        raise WeightsError(path, f"does not fit the network ({' '.join(str(error).split())[:200]})", RETRAIN) from error
