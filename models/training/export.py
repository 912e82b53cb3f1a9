"""From the trained autoencoder to the graphs that run: the encoder in 8 bits, and the decoder."""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

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


@dataclass(kw_only=True)
class ExportOptions:
    """Writes encoder.onnx and decoder.onnx: weights and activations in 8 bits, their ranges from training pictures.

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


class _Feeds:
    """What the quantiser asks for: one input after the other. (CalibrationDataReader's face.)"""

    def __init__(self, feeds: Iterator[dict[str, np.ndarray]]) -> None:
        self._feeds = feeds

    def get_next(self) -> dict[str, np.ndarray] | None:
        """The next input by its name; None after the last one."""
        return next(self._feeds, None)


def quantised(model: onnx.ModelProto, inputs: np.ndarray, operators: list[str]) -> onnx.ModelProto:
    """`model` of one input with weights (symmetric, per channel) and activations of `operators` in 8 bits.

    Their ranges come from `inputs` (n, ...).
    """
    from onnxruntime.quantization import QuantFormat, QuantType, quantize_static
    from onnxruntime.quantization.shape_inference import quant_pre_process

    name = model.graph.input[0].name
    with tempfile.TemporaryDirectory() as folder:
        given, whole, small = (Path(folder, f"{name}.onnx") for name in ("given", "float", "int8"))
        onnx.save(model, given)
        quant_pre_process(given, whole, skip_optimization=True, skip_symbolic_shape=True)
        quantize_static(
            whole, small, _Feeds({name: row[None]} for row in tqdm(inputs, desc=f"ranges of {name}", disable=None)),
            quant_format=QuantFormat.QDQ, activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8,
            per_channel=True, op_types_to_quantize=operators,
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
    if options.pictures < 1:
        raise InputError(f"--pictures {options.pictures} is too small: choose 1 or more")
    model, trained = load_autoencoder(options.autoencoder)
    pictures = sample_pictures(options.data, options.pictures)
    origin = {"autoencoder": file_hash(options.autoencoder), "data_hash": read_header(options.data).content_hash}
    header = {"metadata": trained | {"export": origin | {"pictures": len(pictures)}}}
    paths = [options.out / "encoder.onnx", options.out / "decoder.onnx"]
    encoder = quantised(encoder_graph(model), pictures, ["Conv", "Gemm"])
    write_graph(paths[0], encoder.SerializeToString(), {"kind": "encoder"} | header)
    features = Encoder(paths[0]).encode_batch(pictures).astype(np.float32)
    decoder = halved(quantised(decoder_graph(model), features, ["Gemm"]))  # a picture is for people: 8 bits are few
    write_graph(paths[1], decoder.SerializeToString(), {"kind": "decoder"} | header)
    print(f"written: {', '.join(map(str, paths))}")
