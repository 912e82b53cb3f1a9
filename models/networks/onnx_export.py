"""The torch modules as the ONNX graphs that run: standard operators, weights under the names that torch gives them."""

import copy
import logging
import warnings
from typing import Any

import numpy as np
import onnx
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval, fuse_linear_bn_eval

from models.errors import InputError
from models.interrupts import held
from models.networks.cae import FEATURE_SIZE, IMAGE_SIZE, ConvolutionalAutoencoder
from models.networks.recall import RecallHeads
from models.networks.rnn import RecurrentNetwork

OPSET = 20


class _Tick(nn.Module):
    """One tick of a policy: x (1, M + F), c_{k-1} (1, S) to y, c_k and what c_k recalls (1, N, M)."""

    def __init__(self, rnn: RecurrentNetwork, recall: RecallHeads | None) -> None:
        super().__init__()
        self.rnn, self.recall = rnn, recall

    def forward(self, x: Tensor, state: Tensor) -> tuple[Tensor, ...]:
        y, after = self.rnn.step(x, state)
        return (y, after) if self.recall is None else (y, after, self.recall(after))


class _Encoder(nn.Module):
    """Pictures, uint8 (B, 112, 112, 3), to features (B, 30); batch norms folded into the layers before them."""

    def __init__(self, model: ConvolutionalAutoencoder) -> None:
        super().__init__()
        layers: Any = model.encoder
        self.convolutions = nn.Sequential()
        for name in ("conv0", "conv1", "conv2"):
            fused = fuse_conv_bn_eval(getattr(layers, name), getattr(layers, f"{name}_norm"))
            self.convolutions.append(fused).append(nn.ReLU())
        self.full = fuse_linear_bn_eval(layers.full, layers.full_norm)
        self.feature = fuse_linear_bn_eval(layers.feature, layers.feature_norm)
        self.activation = layers.feature_activation

    def forward(self, picture: Tensor) -> Tensor:
        x = self.convolutions(picture.permute(0, 3, 1, 2).float() / 255.0)
        return self.activation(self.feature(torch.relu(self.full(x.flatten(1)))))


class _Decoder(nn.Module):
    """Features (B, 30) to pictures, uint8 (B, 112, 112, 3)."""

    def __init__(self, model: ConvolutionalAutoencoder) -> None:
        super().__init__()
        self.decoder = model.decoder

    def forward(self, features: Tensor) -> Tensor:
        return (255.0 * self.decoder(features).clamp(0.0, 1.0)).round().to(torch.uint8).permute(0, 2, 3, 1)


def policy_graph(rnn: RecurrentNetwork, recall: RecallHeads | None) -> bytes:
    """The recurrent network and its recall heads, if any, as one graph; matrices in float16, computed in float32.

    Raises InputError for a network that cannot be exported.
    """
    inputs = {"x": torch.zeros(1, rnn.input_size), "state": torch.zeros(1, rnn.state_size)}
    outputs = ["y", "next_state"] + ([] if recall is None else ["recalled"])
    try:
        model = _export(_Tick(copy.deepcopy(rnn), copy.deepcopy(recall)), inputs, outputs)
    except torch.onnx.OnnxExporterError as error:
        if isinstance(error.__cause__, MemoryError):  # no fault of the network's
            raise error.__cause__ from error
        words = " ".join(str(error.__cause__ or error).split())[:300]
        raise InputError(f"the network {rnn.name} cannot be exported as a graph ({words}): see `step`") from error
    parts = {"rnn": rnn} | ({} if recall is None else {"recall": recall})
    wanted = {f"{part}.{name}" for part, module in parts.items() for name in module.state_dict()}
    if lost := sorted(wanted - {tensor.name for tensor in model.graph.initializer}):
        raise InputError(
            f"the network {rnn.name} cannot be exported with its weights ({', '.join(lost)} are missing): "
            "let `step` use each parameter as it is"
        )
    return halved(model).SerializeToString(deterministic=True)


def heads_graph(heads: RecallHeads, state_size: int) -> bytes:
    """Recall heads alone: `state` (1, S) to `recalled` (1, N, M); matrices in float16, computed in float32."""
    model = _export(copy.deepcopy(heads), {"state": torch.zeros(1, state_size)}, ["recalled"])
    return halved(model).SerializeToString(deterministic=True)


def encoder_graph(model: ConvolutionalAutoencoder) -> onnx.ModelProto:
    """The encoder in float32: `picture`, uint8 (B, 112, 112, 3), to `features` (B, 30)."""
    picture = torch.zeros(2, IMAGE_SIZE, IMAGE_SIZE, 3, dtype=torch.uint8)
    return _export(_Encoder(model), {"picture": picture}, ["features"], batched=True)


def decoder_graph(model: ConvolutionalAutoencoder) -> onnx.ModelProto:
    """The decoder in float32: `features` (B, 30) to `picture`, uint8 (B, 112, 112, 3)."""
    return _export(_Decoder(model), {"features": torch.zeros(2, FEATURE_SIZE)}, ["picture"], batched=True)


def _export(module: nn.Module, inputs: dict[str, Tensor], outputs: list[str], batched: bool = False) -> onnx.ModelProto:
    shapes = {name: {0: torch.export.Dim("batch", min=1, max=4096)} for name in inputs} if batched else None
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)  # it says at each export which packages it could use and does not need
    try:
        with held(), warnings.catch_warnings():  # torch takes a request to end for a failure of its own
            warnings.simplefilter("ignore")
            program = torch.onnx.export(
                module.eval().cpu(), kwargs=inputs, input_names=list(inputs), output_names=outputs,
                dynamic_shapes=shapes, opset_version=OPSET, dynamo=True, verbose=False, external_data=False,
            )  # fmt: skip
    finally:
        logger.setLevel(level)
    assert program is not None
    return _without_notes(program.model_proto)


def _without_notes(model: onnx.ModelProto) -> onnx.ModelProto:
    """Without what the exporter notes of this machine, its sources among it: the same network, the same bytes."""
    for field in ("metadata_props", "doc_string", "producer_version"):
        model.ClearField(field)
    for part in (model.graph, *model.graph.node, *model.graph.input, *model.graph.output, *model.graph.initializer):
        part.ClearField("metadata_props")
        part.ClearField("doc_string")
    del model.graph.value_info[:]
    return model


def halved(model: onnx.ModelProto) -> onnx.ModelProto:
    """`model` with its float32 matrices stored as float16 under their names: half the file. Computed in float32."""
    graph, casts = model.graph, {}
    for tensor in graph.initializer:
        if tensor.data_type == onnx.TensorProto.FLOAT and len(tensor.dims) > 1:
            values = onnx.numpy_helper.to_array(tensor).astype(np.float16)
            tensor.CopyFrom(onnx.numpy_helper.from_array(values, tensor.name))
            casts[tensor.name] = f"{tensor.name}.float32"
    for node in graph.node:
        node.input[:] = [casts.get(name, name) for name in node.input]
    nodes = [onnx.helper.make_node("Cast", [name], [cast], to=onnx.TensorProto.FLOAT) for name, cast in casts.items()]
    nodes += graph.node
    del graph.node[:]
    graph.node.extend(nodes)
    return model
