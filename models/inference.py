"""The trained networks as plain numpy functions, in ONNX Runtime: what the systems use.

One thread, batch 1, deterministic: the same bits from run to run and from process to process.
"""

from pathlib import Path

import numpy as np
import onnxruntime

from models.files.container import RETRAIN, WeightsError
from models.files.graphs import Graph, read_graph
from models.files.policies import PolicyFacts, read_policy

LARGEST_SIZE = 100_000  # of a vector that goes into a graph or comes out
BATCH = 64  # pictures that are encoded at once
IMAGE_SIZE = 112  # width and height of a picture, pixels
_PICTURE = ("tensor(uint8)", IMAGE_SIZE, IMAGE_SIZE, 3)

Port = tuple[str | int, ...]  # type, then the sizes after the batch's; 0: any


class _Session:
    """A graph that runs: arrays in and out by the names of its inputs and outputs."""

    def __init__(self, path: str | Path, graph: Graph, inputs: dict[str, Port], outputs: dict[str, Port]) -> None:
        """Raises WeightsError unless the graph runs and has these inputs and outputs."""
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.use_deterministic_compute = True
        options.log_severity_level = 4  # what is wrong is raised
        try:
            self._session = onnxruntime.InferenceSession(graph.content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # the runtime raises a class of its own for each thing that can be wrong
            words = " ".join(str(error).split())[:300]
            raise WeightsError(path, f"its graph cannot be run ({words})", RETRAIN) from error
        have = {port.name: (port.type, *port.shape) for port in self._session.get_inputs()}
        have_out = {port.name: (port.type, *port.shape) for port in self._session.get_outputs()}
        remedy = "models/README.md says what a graph computes"
        if (have.keys(), have_out.keys()) != (inputs.keys(), outputs.keys()):
            is_, should_be = (" -> ".join(map(", ".join, both)) for both in ((have, have_out), (inputs, outputs)))
            raise WeightsError(path, f"its graph computes {is_}, where {should_be} is needed", remedy)
        have |= have_out
        for name, wanted in (inputs | outputs).items():
            kind, batch, *sizes = have[name]
            fits = (kind, len(sizes)) == (wanted[0], len(wanted) - 1) and (batch == 1 or not isinstance(batch, int))
            for size, want in zip(sizes, wanted[1:], strict=False):
                fits &= isinstance(size, int) and 1 <= size <= LARGEST_SIZE and want in (0, size)
            if not fits:
                shape = f"{wanted[0]} [1, {', '.join(str(n or 'n') for n in wanted[1:])}]"
                raise WeightsError(path, f"its {name} is {kind} {[batch, *sizes]}, where {shape} is needed", remedy)
        self.sizes = {name: tuple(port[2:]) for name, port in have.items()}
        self._outputs = list(outputs)

    def __call__(self, **inputs: np.ndarray) -> list[np.ndarray]:
        return self._session.run(self._outputs, inputs)


class Encoder:
    """Pictures to features.

    Attributes:
        feature_size: F.
        hash: SHA-256 of the file.
    """

    def __init__(self, path: str | Path) -> None:
        """Raises WeightsError unless `path` is an encoder's file."""
        graph = read_graph(path, "encoder")
        self._session = _Session(path, graph, {"picture": _PICTURE}, {"features": ("tensor(float)", 0)})
        self.hash, self.feature_size = graph.hash, self._session.sizes["features"][0]

    def encode(self, rgb: np.ndarray) -> np.ndarray:
        """uint8 (112, 112, 3) to features, float64 (F,)."""
        _check(rgb, 3)
        return self._session(picture=rgb[None])[0][0].astype(float)

    def encode_batch(self, rgb: np.ndarray) -> np.ndarray:
        """uint8 (B, 112, 112, 3) to features, float64 (B, F); equal to encode, to the bit."""
        _check(rgb, 4)
        parts = [self._session(picture=rgb[i : i + BATCH])[0] for i in range(0, len(rgb), BATCH)]
        return np.concatenate([np.empty((0, self.feature_size)), *parts])


def _check(rgb: np.ndarray, ndim: int) -> None:
    shape = (IMAGE_SIZE, IMAGE_SIZE, 3)
    if rgb.dtype != np.uint8 or rgb.ndim != ndim or rgb.shape[-3:] != shape:
        raise ValueError(f"the encoder takes uint8 pictures {shape}, not {rgb.dtype} {rgb.shape}")


class Decoder:
    """Features back to pictures, for people to look at."""

    def __init__(self, path: str | Path) -> None:
        """Raises WeightsError unless `path` is a decoder's file."""
        graph = read_graph(path, "decoder")
        self._session = _Session(path, graph, {"features": ("tensor(float)", 0)}, {"picture": _PICTURE})

    def decode(self, features: np.ndarray) -> np.ndarray:
        """Features (F,) to uint8 (112, 112, 3)."""
        return self._session(features=np.asarray(features, np.float32)[None])[0][0]


class Policy(PolicyFacts):
    """Recurrent network and recall heads of a policy file; everything scaled but initial_posture and scaling's bounds.

    Attributes, beside those of PolicyFacts:
        hash: SHA-256 of the file.
        posture_size, feature_size, state_size, horizon: M, F, S, N.
        initial_state: c_0 (S,), zeros.
    """

    def __init__(self, path: str | Path) -> None:
        """Raises WeightsError unless `path` is a policy's file with recall heads."""
        facts, graph = read_policy(path)
        super().__init__(**vars(facts))
        if self.torch is not None and self.torch.get("recall") is None:
            remedy = f"Train them: `python -m models.training recall --policy {path}`"
            raise WeightsError(path, "is a candidate without recall heads", remedy)
        self.hash, self.posture_size = graph.hash, len(self.initial_posture)
        number = "tensor(float)"
        outputs: dict[str, Port] = {"y": (number, 0), "next_state": (number, 0)}
        outputs["recalled"] = (number, 0, self.posture_size)
        self._session = _Session(path, graph, {"x": (number, 0), "state": (number, 0)}, outputs)
        sizes = self._session.sizes
        if sizes["x"] != sizes["y"] or sizes["state"] != sizes["next_state"] or sizes["x"][0] <= self.posture_size:
            wrong = (
                f"its graph maps x {sizes['x']} and state {sizes['state']} to y {sizes['y']} and {sizes['next_state']}"
            )
            raise WeightsError(path, wrong, f"x and y have the {self.posture_size} of the posture, then the features")
        self.feature_size, self.state_size = sizes["x"][0] - self.posture_size, sizes["state"][0]
        self.horizon = sizes["recalled"][0]
        self.initial_state = np.zeros(self.state_size)

    def step(self, x: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One tick: x (M + F,) scaled [m_k, f_k] and c_{k-1} (S,).

        Returns y (M + F,), the prediction of k+1, unclipped; c_k (S,); and the postures that c_k recalls (N, M), row
        n - 1 is m_{k-n}.
        """
        found = self._session(x=np.asarray(x, np.float32)[None], state=np.asarray(state, np.float32)[None])
        y, after, recalled = (value[0].astype(float) for value in found)
        return y, after, recalled
