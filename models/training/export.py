"""From the trained autoencoder to the graphs that run: the encoder in 8 bits, and the decoder."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnx
from tqdm import tqdm

from models.data.demonstrations import iterate_frames, read_demonstrations, read_header
from models.errors import InputError
from models.files.container import file_hash
from models.files.graphs import write_graph
from models.files.weights import load_autoencoder
from models.inference import Encoder
from models.networks.onnx_export import decoder_graph, encoder_graph, halved

MOST_PICTURES = 10_000


@dataclass(kw_only=True)
class ExportOptions:
    """Writes encoder.onnx, all but its last layer in 8 bits, and decoder.onnx, its full layers in 8 bits.

    The ranges of the activations come from training pictures.

    What the recurrent networks are trained on is what this encoder gives. (Their own files are graphs from the start.)

    Args:
        data: data set of diagrams/teach.py (HDF5).
        autoencoder: file of `training cae`.
        out: folder of the two files.
        pictures: evenly spaced pictures of the training demonstrations, from which the ranges are taken.
    """

    data: Path
    autoencoder: Path
    out: Path
    pictures: int = 400


def quantised(
    model: onnx.ModelProto, inputs: np.ndarray, operators: list[str], but: list[str] | None = None
) -> onnx.ModelProto:
    """`model` of one input with weights (symmetric, per channel) and activations of `operators` in 8 bits.

    Their ranges come from `inputs` (n, ...); the nodes named in `but` stay as they are.
    """
    from onnxruntime.quantization import QuantFormat, QuantType, quantize_static
    from onnxruntime.quantization.shape_inference import quant_pre_process

    name = model.graph.input[0].name
    feeds = ({name: row[None]} for row in tqdm(inputs, desc=f"ranges of {name}", disable=None))
    with tempfile.TemporaryDirectory() as folder:
        given, whole, small = (Path(folder, f"{name}.onnx") for name in ("given", "float", "int8"))
        onnx.save(model, given)
        quant_pre_process(given, whole, skip_optimization=True, skip_symbolic_shape=True)
        quantize_static(
            whole, small, SimpleNamespace(get_next=lambda: next(feeds, None)),
            quant_format=QuantFormat.QDQ, activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8,
            per_channel=True, op_types_to_quantize=operators, nodes_to_exclude=but,
        )  # fmt: skip
        return onnx.load(small)


def sample_pictures(path: Path, count: int) -> np.ndarray:
    """About `count` pictures, uint8 (n, 112, 112, 3), as many and evenly spaced of each training demonstration."""
    names = [demo.name for demo in read_demonstrations(path, "train")]
    each = -(-count // len(names))
    parts = [rgb[np.linspace(0, len(rgb) - 1, min(each, len(rgb))).astype(int)] for rgb in iterate_frames(path, names)]
    return np.concatenate(parts)


def export(options: ExportOptions) -> None:
    """Writes the two files; raises InputError for data or an autoencoder that cannot be used."""
    if not 1 <= options.pictures <= MOST_PICTURES:
        raise InputError(f"--pictures {options.pictures} is out of range: choose from 1 to {MOST_PICTURES}")
    model, trained = load_autoencoder(options.autoencoder)
    pictures = sample_pictures(options.data, options.pictures)
    origin = {"autoencoder": file_hash(options.autoencoder), "data_hash": read_header(options.data).content_hash}
    header = {"metadata": trained | {"export": origin | {"pictures": len(pictures)}}}
    paths = [options.out / "encoder.onnx", options.out / "decoder.onnx"]
    encoder = encoder_graph(model)
    # The layer of the features stays in float32: it is small, and their sums in 8 bits cost half a millimetre.
    features_layer = [node.name for node in encoder.graph.node if node.op_type == "Gemm"][-1:]
    encoder = quantised(encoder, pictures, ["Conv", "Gemm"], features_layer)
    write_graph(paths[0], encoder.SerializeToString(), {"kind": "encoder"} | header)
    features = Encoder(paths[0]).encode_batch(pictures).astype(np.float32)
    decoder = halved(quantised(decoder_graph(model), features, ["Gemm"]))  # for the file's size
    write_graph(paths[1], decoder.SerializeToString(), {"kind": "decoder"} | header)
    print(f"written: {', '.join(map(str, paths))}")
