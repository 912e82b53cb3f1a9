"""Any of PyOD's detectors of outliers, by its name."""

import functools
import importlib
import inspect
import pkgutil

import numpy as np

from models.command_line import require
from models.data.runs import Tape, rows_of
from models.errors import InputError
from systems.arguments import require_arrays
from systems.vector_detector import VectorDetector

MOST_ROWS = 2000  # that a model is fitted to
SEED = 0


class PyodDetector(VectorDetector):
    """l = max(0, s(x) - s_min) / (s_mean - s_min), s the model's decision_function, x = [c_{k-1}, f_k].

    PyOD (Zhao, Nasrullah and Li, PyOD: a Python toolbox for scalable outlier detection, JMLR 20, 2019; Chen et al.,
    PyOD 2, 2024) with each model's defaults. s_min and s_mean are those of the rows that it is fitted to: scores have
    no zero of their own. These rows are what a file keeps, never a pickle: the model is fitted when it is built.

    The models are not made for one row at a time: IForest, for one, takes some 5 ms a tick.

    .. pydrake_system::

        name: PyodDetector
        input_ports: [posture_history, recalled_postures, hidden_state, features]
        output_ports: [errors, alpha]

    Ports: see VectorDetector. Needs PyOD.
    """

    name = "pyod"
    reads = ("hidden_state", "features")

    def __init__(self, policy, model, rows: np.ndarray):
        """`policy`: see VectorDetector; model: of PyOD, not fitted yet; rows (n, D), of normal runs."""
        super().__init__(policy)
        rows = np.asarray(rows, float)
        self.require_width(rows.shape[1])
        before = np.random.get_state()  # noqa: NPY002 (some models draw from numpy's one generator)
        np.random.seed(SEED)  # noqa: NPY002
        try:
            self._model = model.fit(rows)
            scores = self._model.decision_function(rows)
        finally:
            np.random.set_state(before)  # noqa: NPY002
        self._lowest, mean = float(scores.min()), float(scores.mean())
        if not mean > self._lowest or not np.isfinite(scores).all():
            raise ValueError(f"the scores of normal runs are {self._lowest:g} on average: choose another model.")
        self._span = mean - self._lowest

    @staticmethod
    def fit(runs: list[Tape]) -> dict[str, np.ndarray]:
        """rows (n, D) float32, at most MOST_ROWS, drawn evenly."""
        rows = rows_of(runs, *PyodDetector.reads)
        kept = np.linspace(0, len(rows) - 1, min(len(rows), MOST_ROWS)).round().astype(int)
        return {"rows": rows[kept].astype(np.float32)}

    def anomaly(self, rows):
        """See VectorDetector; 1 on average on the rows that it was fitted to."""
        return np.maximum(self._model.decision_function(rows) - self._lowest, 0.0) / self._span


@functools.cache
def pyod_detector(name: str) -> type:
    """The detector with PyOD's model of that name, such as IForest; raises InputError where there is none."""
    require("pyod", extra="monitors")
    kind = _model(name)

    class Chosen(PyodDetector):
        __doc__ = PyodDetector.__doc__

        @staticmethod
        def build(policy, joints, arrays):
            """Returns the detector of what `fit` gave, fitted to it now."""
            require_arrays(arrays, "rows")
            seeded = {"random_state": SEED} if "random_state" in inspect.signature(kind).parameters else {}
            try:
                return Chosen(policy, kind(**seeded), arrays["rows"])
            except (TypeError, ValueError, RuntimeError, ModuleNotFoundError) as error:
                words = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
                raise InputError(f"PyOD's {kind.__name__} cannot be fitted ({words}): choose another") from error

    Chosen.name = f"pyod-{kind.__name__}"
    Chosen.__name__ = Chosen.__qualname__ = f"PyodDetector{kind.__name__}"
    return Chosen


def _model(name: str) -> type:
    import pyod.models

    modules = [module.name for module in pkgutil.iter_modules(pyod.models.__path__)]
    likely = [module for module in modules if module.replace("_", "") == name.lower().replace("_", "")]
    for module in likely:
        try:
            found = getattr(importlib.import_module(f"pyod.models.{module}"), name, None)
        except ModuleNotFoundError as error:
            raise InputError(f"PyOD's {name} needs {error.name}: install it, or choose another") from error
        if inspect.isclass(found):
            return found
    raise InputError(f"PyOD has no detector '{name}': choose one of its models, such as pyod:IForest or pyod:ECOD")
