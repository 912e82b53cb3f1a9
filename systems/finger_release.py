"""Fingers that hold nothing open where the network starts anew."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from systems.arguments import require_bounds, require_count


class FingerRelease(LeafSystem):
    """Passes the command through, but at home it opens the fingers that are closed on nothing.

    Whatever is between the fingers stalls them at its width: a measured gap below that says that there is nothing. Both
    subtasks begin with fingers that are open or hold something, and the network starts anew with that.

    .. pydrake_system::

        name: FingerRelease
        input_ports: [desired_posture, reset, finger_gaps]
        output_ports: [released_posture]

    Inputs:
        desired_posture: (M,) the command, joint angles in rad, then the openings of the fingers in m.
        reset: (1,) above 1/2: the network starts anew; as it was at the tick.
        finger_gaps: (M - J,) m, the openings as measured at the tick.
    Outputs:
        released_posture: (M,) the command; where `reset` is 1, fingers whose gap is below `empty_below` open.

    Direct feedthrough, no state. A step has no derivative: no AutoDiff.
    """

    def __init__(self, *, posture_size: int, joints: int, opening: np.ndarray, empty_below: np.ndarray):
        """
        Args:
            posture_size: M.
            joints: J < M, the first J components are joint angles.
            opening: (M - J,) command of open fingers, m.
            empty_below: (M - J,) m, measured gaps below which fingers hold nothing, below `opening`.

        Raises ValueError for other shapes or bounds.
        """
        super().__init__()
        size = require_count("posture_size", posture_size, 2)
        self._joints = require_count("joints", joints, 1, size - 1)
        self._empty_below, self._opening = require_bounds(
            "empty_below", empty_below, "opening", opening, size - self._joints
        )
        self._desired = self.DeclareVectorInputPort("desired_posture", size)
        self._reset = self.DeclareVectorInputPort("reset", 1)
        self._gaps = self.DeclareVectorInputPort("finger_gaps", size - self._joints)
        reads = {self.all_input_ports_ticket()}
        self.DeclareVectorOutputPort("released_posture", size, self._calc_released_posture, reads)

    def _calc_released_posture(self, context: Context, output: BasicVector) -> None:
        command = self._desired.Eval(context).copy()
        if self._reset.Eval(context)[0] > 0.5:
            empty = self._gaps.Eval(context) < self._empty_below
            command[self._joints :][empty] = self._opening[empty]
        output.SetFromVector(command)
