"""The return: Drake's LQR for the discrete posture integrator, shifted to the initial posture (Sec. III-D)."""

import numpy as np
from pydrake.math import DiscreteAlgebraicRiccatiEquation
from pydrake.systems.controllers import LinearQuadraticRegulator
from pydrake.systems.primitives import AffineSystem, LinearSystem

from systems.arguments import require_count, require_positive, require_vector


def _as_weight(name: str, value, size: int) -> np.ndarray:
    """Returns `value` times the identity if it is a number, else the symmetric positive definite matrix (n, n)."""
    weight = np.asarray(value, dtype=float)
    if weight.ndim == 0:
        return require_positive(name, float(weight)) * np.eye(size)
    if weight.shape != (size, size) or not np.all(np.isfinite(weight)) or not np.array_equal(weight, weight.T):
        raise ValueError(
            f"{name} is {weight}; it must be a number > 0 or a symmetric matrix of shape ({size}, {size}): pass one."
        )
    smallest = np.linalg.eigvalsh(weight)[0]
    if smallest <= 0.0:
        raise ValueError(
            f"{name} has the eigenvalue {smallest:g}; every one must be greater than 0, or the arm is not brought home "
            "in every joint: pass a positive definite matrix."
        )
    return weight


def lqr(joints: int, Q, R, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Solves the LQR of the discrete integrator m_{k+1} = m_k + dm_k, cost sum of m'Qm + dm'Rdm.

    Args:
        joints: J, number of joints.
        Q, R: numbers > 0 or (J, J) matrices: cost of the deviation and of the step, both in the posture's unit.
        period: of the ticks, s; marks the system as discrete, the gain doesn't depend on it.

    Returns:
        The gain K (J, J) of dm = -K m, per tick, and the Riccati matrix S (J, J): m'Sm is the cost to go.
    """
    joints = require_count("joints", joints)
    Q, R = _as_weight("Q", Q, joints), _as_weight("R", R, joints)
    identity = np.eye(joints)
    integrator = LinearSystem(
        identity, identity, identity, np.zeros((joints, joints)), require_positive("period", period)
    )
    K = -LinearQuadraticRegulator(integrator, Q, R).D()
    return K, DiscreteAlgebraicRiccatiEquation(identity, identity, Q, R)


def make_posture_regulator(
    *, posture_size: int, joints: int, initial_posture: np.ndarray, Q, R, period: float
) -> AffineSystem:
    """Returns the LQR, dm^L_k = -K (m_k - m_init), as a system that converts to any scalar type.

    Input u0: (M,) m_k, scaled or physical, like `initial_posture`. Output y0: (M,) dm^L_k in the first J components, 0
    in the others; unit of the posture, per tick. Direct feedthrough, no state.

    Args:
        posture_size: M.
        joints: J <= M; the first J components are regulated (the fingers, which come last, are not).
        initial_posture: (M,) m_init, unit of the input.
        Q, R, period: see `lqr`.
    """
    size = require_count("posture_size", posture_size)
    joints = require_count("joints", joints, maximum=size)
    initial = require_vector("initial_posture", initial_posture, size)
    gain = np.zeros((size, size))
    gain[:joints, :joints], _ = lqr(joints, Q, R, period)
    return AffineSystem(D=-gain, y0=gain @ initial)
