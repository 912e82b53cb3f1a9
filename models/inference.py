"""The trained networks as plain numpy functions, in ONNX Runtime: what the systems use.

One thread, batch 1, deterministic: the same bits from run to run and from process to process.
"""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from models.files.container import WeightsError
from models.files.graphs import REMEDY, Graph, read_graph
from models.files.policies import PolicyFacts, read_policy
from models.policy import Policy as OwnPolicy
from models.policy import make_policy

onnxruntime.set_default_logger_severity(4)  # what is wrong is raised; its allocator has no session's options
CALIBRATE = "Run diagrams/calibrate.py on it again"
LARGEST_SIZE = 100_000  # of what goes into a graph or comes out
BATCH = 64  # pictures that are encoded at once
IMAGE_SIZE = 112  # width and height of a picture, pixels
_PICTURE = (np.uint8, (IMAGE_SIZE, IMAGE_SIZE, 3))
_VECTOR = (np.float32, (0,))

Port = tuple[type, tuple[int, ...]]  # type, and the sizes after the batch's; 0: any


class _Session:
    """A graph that runs: arrays in and out by the names of its inputs and outputs.

    Attributes:
        shapes: of each input and output, without the batch's size.
    """

    def __init__(
        self, path: str | Path, graph: Graph, inputs: dict[str, Port], outputs: dict[str, Port], batch: int = 1
    ) -> None:
        """Raises WeightsError unless the graph has these inputs and outputs, and runs, on zeros, for that batch."""
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.use_deterministic_compute = True
        options.log_severity_level = 4  # what is wrong is raised
        self._path, self._outputs = path, list(outputs)
        try:
            self._session = onnxruntime.InferenceSession(graph.content, options, providers=["CPUExecutionProvider"])
            given = {port.name: port.shape[1:] for port in self._session.get_inputs()}
            made = [port.name for port in self._session.get_outputs()]
            if (given.keys(), set(made)) != (inputs.keys(), outputs.keys()):
                words = f"{', '.join(given)} -> {', '.join(made)}, where {', '.join(inputs)} -> {', '.join(outputs)}"
                raise WeightsError(path, f"its graph computes {words} is needed", REMEDY)
            if any(not isinstance(size, int) or size > LARGEST_SIZE for shape in given.values() for size in shape):
                raise WeightsError(path, f"its inputs have the sizes {given}: fixed ones are needed", REMEDY)
            found = {name: np.zeros((batch, *shape), inputs[name][0]) for name, shape in given.items()}
            found |= zip(outputs, self(**found), strict=True)
        except WeightsError:
            raise
        except Exception as error:  # as in __call__
            words = " ".join(str(error).split())[:300]
            raise WeightsError(path, f"its graph cannot be run ({words})", REMEDY) from error
        self.shapes = {name: value.shape[1:] for name, value in found.items()}
        for name, (kind, sizes) in (inputs | outputs).items():
            shape, is_kind = self.shapes[name], found[name].dtype
            fits = len(shape) == len(sizes) and all(want in (0, size) for want, size in zip(sizes, shape, strict=True))
            if not fits or is_kind != kind or not all(1 <= size <= LARGEST_SIZE for size in shape):
                needed = f"{np.dtype(kind)} ({', '.join(str(size or 'n') for size in sizes)})"
                limit = f"n from 1 to {LARGEST_SIZE}"
                raise WeightsError(path, f"its {name} is {is_kind} {shape}, where {needed}, {limit}, is needed", REMEDY)
            if not np.isfinite(found[name]).all():
                raise WeightsError(path, f"its {name} is not finite where its inputs are 0", REMEDY)

    def __call__(self, **inputs: np.ndarray) -> list[np.ndarray]:
        """Raises WeightsError where the graph, which ran on zeros, does not run on these `inputs`."""
        try:
            return self._session.run(self._outputs, inputs)
        except Exception as error:  # the runtime raises a class of its own for each thing that can be wrong
            words = " ".join(str(error).split())[:300]
            raise WeightsError(self._path, f"its graph cannot be run ({words})", REMEDY) from error


class Encoder:
    """Pictures to features.

    Attributes:
        feature_size: F.
        hash: SHA-256 of the file.
    """

    def __init__(self, path: str | Path) -> None:
        """Raises WeightsError unless `path` is an encoder's file."""
        graph = read_graph(path, "encoder")
        self._session = _Session(path, graph, {"picture": _PICTURE}, {"features": _VECTOR}, batch=2)
        self.hash, (self.feature_size,) = graph.hash, self._session.shapes["features"]

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
        self._session = _Session(path, graph, {"features": _VECTOR}, {"picture": _PICTURE})

    def decode(self, features: np.ndarray) -> np.ndarray:
        """Features (F,) to uint8 (112, 112, 3)."""
        return self._session(features=np.asarray(features, np.float32)[None])[0][0]


class Policy(PolicyFacts):
    """Recurrent network and recall heads of a policy file; everything scaled but initial_posture and scaling's bounds.

    Attributes, beside those of PolicyFacts:
        path, hash: the file, and its SHA-256.
        posture_size, feature_size, state_size, horizon: M, F, S, N.
        initial_state: c_0 (S,), zeros.
    """

    def __init__(self, path: str | Path, content: bytes | None = None) -> None:
        """Raises WeightsError unless `path` is a policy's file with recall heads; `content`: of it, if it was read."""
        facts, graph = read_policy(path, content)
        super().__init__(**vars(facts))
        if self.torch is not None and self.torch.get("recall") is None:
            remedy = f"Train them: `python -m models.training recall --policy {path}`"
            raise WeightsError(path, "is a candidate without recall heads", remedy)
        self.path, self.hash, self.posture_size = Path(path), graph.hash, len(self.initial_posture)
        outputs: dict[str, Port] = {
            "y": _VECTOR,
            "next_state": _VECTOR,
            "recalled": (np.float32, (0, self.posture_size)),
        }
        self._session = _Session(path, graph, {"x": _VECTOR, "state": _VECTOR}, outputs)
        shapes = self._session.shapes
        (size,), (self.state_size,), (self.horizon, _) = (shapes[name] for name in ("x", "state", "recalled"))
        self.feature_size = size - self.posture_size
        if shapes["y"] != (size,) or shapes["next_state"] != (self.state_size,) or self.feature_size < 1:
            raise WeightsError(path, f"its graph has the sizes {shapes}", "Make y as long as x, next_state as state")
        if (errors := self.mean_errors) is not None and errors.shape != (self.horizon + 1,):
            raise WeightsError(path, f"has {len(errors)} mean_errors, where {self.horizon + 1} are needed", CALIBRATE)
        self.initial_state = np.zeros(self.state_size)

    def step(self, x: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One tick: x (M + F,) scaled [m_k, f_k] and c_{k-1} (S,).

        Returns y (M + F,), the prediction of k+1, unclipped; c_k (S,); and the postures that c_k recalls (N, M), row
        n - 1 is m_{k-n}.
        """
        found = self._session(x=np.asarray(x, np.float32)[None], state=np.asarray(state, np.float32)[None])
        y, after, recalled = (value[0].astype(float) for value in found)
        return y, after, recalled


class RecalledPolicy:
    """A policy of one's own (models/policy.py) with recall heads that were trained on its hidden state.

    Attributes: the policy's own, but for `recalls`, `horizon` and `hash`, which speaks for both.
    """

    recalls = True

    def __init__(self, policy: OwnPolicy, path: str | Path) -> None:
        """Raises WeightsError unless `path` is a file of `training recall` for `policy`."""
        graph = read_graph(path, "recall")
        if (trained := graph.header.get("policy")) != policy.hash:
            wrong = f"was trained on the states of another {policy.name}, {str(trained)[:12]}, not {policy.hash[:12]}"
            raise WeightsError(path, wrong, "Train heads again: `python -m models.training recall --policy ...`")
        recalled: dict[str, Port] = {"recalled": (np.float32, (0, policy.posture_size))}
        self._session = _Session(path, graph, {"state": (np.float32, (policy.state_size,))}, recalled)
        self._policy, (self.horizon, _) = policy, self._session.shapes["recalled"]
        self.hash = hashlib.sha256(f"{policy.hash} {graph.hash}".encode()).hexdigest()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # asked for before there is a policy, by copy and pickle
            raise AttributeError(name)
        return getattr(self._policy, name)

    def step(
        self, x: np.ndarray, state: np.ndarray, picture: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As Policy.step."""
        y, after, _ = self._policy.step(x, state, picture)
        return y, after, self._session(state=np.asarray(after, np.float32)[None])[0][0].astype(float)


def own_policy(spec: str, folder: Path) -> OwnPolicy | RecalledPolicy:
    """The policy that `spec` names (package.module:Class), with the heads `recall_file` in `folder` if they are there.

    Raises InputError as `make_policy` does, WeightsError for heads that are not for it.
    """
    policy = make_policy(spec)
    path = recall_file(folder, policy.name)
    return RecalledPolicy(policy, path) if path.is_file() else policy


def recall_file(folder: Path, name: str) -> Path:
    """Where the recall heads of the policy of one's own with that name lie."""
    return folder / f"{name}-recall.onnx"
