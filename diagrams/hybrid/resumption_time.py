"""The time to resume, as a Lyapunov function of mode `return` with the arm at home.

There the network runs on its own predictions, which nothing outside has a say in, or is in its initial state, and the
arm goes home by the LQR: the state one tick later is a function of the state. So T, the ticks that are left until alpha
falls, is known for each state by stepping the network alone, and falls by one a tick: the region of resumption within a
time is a sublevel set of T. It idealises the servo, and the few ticks with alpha between its low value and 1.
"""

import numpy as np

from diagrams.episodes.switching import RESUMED
from diagrams.hybrid.resumption_starts import Memory
from diagrams.world.names import ARM_JOINTS
from systems.detector import alpha_of
from systems.recall_detector import recall_errors


def time_to_resume(policy, memory: Memory, rows: np.ndarray, gain: float, limit: int, reset: bool) -> int | None:
    """T, ticks, of a network with `memory` and an arm whose joints are and were `rows`; None: more than `limit`.

    Args:
        policy: see models/inference.py, calibrated for the recall.
        rows: (N + 2, 7) scaled, now and at the ticks before; the arm is within the tolerance of the initial posture.
        gain: of the LQR, a tick.
        reset: whether the network starts anew at home, see systems/home_reset.py.
    """
    initial = policy.scaling.scale(policy.initial_posture)
    joints, errors = rows, np.array(policy.mean_errors)
    recalled = np.vstack((memory.predicted[: policy.posture_size], memory.recalled))
    for k in range(limit + 1):
        # m_{k-1}, row 1, has no counterpart: see RecallDetector.
        offsets = np.zeros((policy.horizon + 1, policy.posture_size))
        offsets[:, :ARM_JOINTS] = np.delete(joints, 1, axis=0) - recalled[:, :ARM_JOINTS]
        if alpha_of(recall_errors(offsets, ARM_JOINTS, errors), policy.beta, policy.gamma) <= RESUMED:
            return k
        now = initial[:ARM_JOINTS] + (1.0 - gain) * (joints[0] - initial[:ARM_JOINTS])
        joints = np.vstack((now, joints))[: policy.horizon + 2]
        if reset:
            recalled = np.vstack((initial, recalled[:-1]))
        else:
            memory = memory.imagined(policy)
            recalled = np.vstack((memory.predicted[: policy.posture_size], memory.recalled))
    return None
