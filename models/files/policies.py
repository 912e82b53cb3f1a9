"""Policy files: a recurrent network with its recall heads as one graph, and what belongs to it. No torch in here."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Self

import numpy as np

from models.data.scaling import MinMaxScaling
from models.files.container import WeightsError
from models.files.graphs import REMEDY, Graph, read_graph, write_graph
from models.networks import NETWORKS

_POSITIVE = ("mean_errors", "beta", "gamma")


@dataclass(kw_only=True)
class PolicyFacts:
    """What a policy file says beside its graph; postures in physical units (rad, m), what the calibration gives None
    before it.

    Attributes:
        name: of the network, short.
        scaling: bounds of the posture (M,).
        initial_posture: (M,).
        encoder_hash: hash of the file of the encoder that it goes with.
        mean_errors: (N+1,) mean l_n of normal runs, which l_n is divided by.
        beta, gamma: of the detector's sigmoid.
        torch: what the torch modules are built from again; None where torch did not make them.
        metadata: anything else, JSON-serialisable: training arguments, hash of the data set.
    """

    name: str
    scaling: MinMaxScaling
    initial_posture: np.ndarray
    encoder_hash: str
    mean_errors: np.ndarray | None = None
    beta: float | None = None
    gamma: float | None = None
    torch: dict[str, Any] | None = None
    metadata: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of_header(cls, path: str | Path, header: dict[str, Any]) -> Self:
        """From the header of the file `path`; raises WeightsError where it describes no policy."""
        known = {entry.name for entry in fields(PolicyFacts)} - {"scaling"}
        found = {name: value for name, value in header.items() if name in known}
        try:
            for name in ("initial_posture", "mean_errors", "beta", "gamma"):
                if name in found and (found[name] is not None or name == "initial_posture"):
                    number = np.array(found[name], float)
                    if not np.isfinite(number).all():
                        raise ValueError(f"{name} is {found[name]}")
                    if name in _POSITIVE and not (number >= np.finfo(float).tiny).all():
                        raise ValueError(f"{name} is {found[name]}: numbers above 0 are needed")
                    if name == "mean_errors" and number.ndim != 1:
                        raise ValueError(f"{name} has the shape {number.shape}: a list is needed")
                    found[name] = number if name.endswith(("posture", "errors")) else float(number)
            facts = cls(scaling=MinMaxScaling(header["lower"], header["upper"]), **found)
            if facts.initial_posture.shape != facts.scaling.lower.shape:
                raise ValueError(f"initial_posture has the shape {facts.initial_posture.shape}")
            for name, kind in (("name", str), ("encoder_hash", str), ("metadata", dict), ("torch", dict | None)):
                if not isinstance(getattr(facts, name), kind):
                    raise ValueError(f"{name} is {getattr(facts, name)!r}")
            spec = (facts.torch or {}).get("rnn")
            if spec in list(NETWORKS) and spec != facts.name:
                raise ValueError(f"it calls the network '{spec}' '{facts.name}'")
        except (KeyError, OverflowError, TypeError, ValueError) as error:
            raise WeightsError(path, f"its header does not describe a policy ({error})", REMEDY) from error
        return facts

    def header(self) -> dict[str, Any]:
        """The header that `of_header` reads."""
        found = {entry.name: getattr(self, entry.name) for entry in fields(PolicyFacts)}
        bounds = found.pop("scaling")
        return {"kind": "policy", "lower": bounds.lower.tolist(), "upper": bounds.upper.tolist()} | found


def read_policy(path: str | Path, content: bytes | None = None) -> tuple[PolicyFacts, Graph]:
    """The file `path`, or its `content`; raises WeightsError unless it is a whole policy file."""
    graph = read_graph(path, "policy", content)
    return PolicyFacts.of_header(path, graph.header), graph


def write_policy(path: str | Path, facts: PolicyFacts, content: bytes) -> None:
    """Writes the graph `content` (an ONNX model) and its facts into one file."""
    write_graph(path, content, facts.header())
