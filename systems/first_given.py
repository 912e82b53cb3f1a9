"""Several sources for one signal, by rank; a source that says nothing gives NaN."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from systems.arguments import require_count


class FirstGiven(LeafSystem):
    """Passes on the first of two inputs unless that has a NaN, else the second.

    .. pydrake_system::

        name: FirstGiven
        input_ports: [first, second]
        output_ports: [given]

    Inputs:
        first, second: (n,) each.
    Outputs:
        given: (n,). Direct feedthrough of both.
    """

    def __init__(self, size: int):
        """`size`: n."""
        super().__init__()
        size = require_count("size", size)
        self._first, self._second = (self.DeclareVectorInputPort(name, size) for name in ("first", "second"))
        self.DeclareVectorOutputPort("given", size, self._calc_given, {self.all_input_ports_ticket()})

    def _calc_given(self, context: Context, output: BasicVector) -> None:
        first = self._first.Eval(context)
        output.SetFromVector(self._second.Eval(context) if np.isnan(first).any() else first)
