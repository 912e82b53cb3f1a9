"""The closed loop's map over one tick in mode `task`, and its derivative.

Held: the image features of a scene, and alpha = 0. Two idealisations: the arm is at the commanded posture one tick
later (the servo's lag is a few percent of a step), and the features do not change while the posture does.

State of the map, and why no more: z = (c, m), the network's hidden state (S) and the scaled posture (8, its last
component the *command* of the fingers). The last prediction enters the loop only times alpha (Eqs. 7, 8) and through
alpha, the recalled postures only through alpha; alpha and its derivative are next to nothing at a fixed point, where
nothing moves and all is recalled (`alpha` in the report measures it).

    y, c+ = rnn([m, f], c)                the policy: torch, float64 copy of the weights, Jacobian by torch
    m+    = mixer(m, clip(y), regulator(m), alpha = 0)      Eq. 3: Drake's systems, Jacobian by AutoDiffXd

At alpha = 0 the joints go to the prediction, as far as their limits let them: of m+ only what the network makes of m
depends on m. The fingers take one of two values, or keep theirs: a step, whose derivative is 0 or 1.
"""

import copy
from collections.abc import Callable

import numpy as np
import torch
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.systems.framework import System

from diagrams.hybrid.return_loop import regulated_mixer
from diagrams.world.configuration import World
from diagrams.world.station import PickPlaceStation
from models.errors import InputError
from models.files.weights import StoredPolicy
from models.networks.rnn import RecurrentNetwork

DIFFERENCE = 1e-5  # of the central differences, scaled units


class OneTickMap:
    """The map z -> z+ of one tick with everything that it is differentiated by."""

    def __init__(self, world: World, stored: StoredPolicy, features: np.ndarray):
        """`stored`: network and scaling; `features` (F,), held."""
        self.rnn: RecurrentNetwork = copy.deepcopy(stored.rnn).double()
        self.state_size, self.posture_size = self.rnn.state_size, self.rnn.posture_size
        if len(features) != self.rnn.feature_size:
            raise InputError(f"{len(features)} features do not fit the network, which takes {self.rnn.feature_size}")
        self._features = torch.tensor(np.asarray(features), dtype=torch.float64)
        law = regulated_mixer(world, PickPlaceStation(world, camera=False), stored.scaling)
        self._command, self._command_ad = _command_of(law), _command_of(law.ToAutoDiffXd())

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """One tick: z (S + 8,) to z+."""
        with torch.no_grad():
            out = self._policy(torch.from_numpy(z)).numpy()
        c, y = out[: self.state_size], out[self.state_size :]
        return np.concatenate((c, self._command(z[self.state_size :], y)))

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """dz+/dz (S + 8, S + 8) at z."""
        S, size = self.state_size, self.posture_size
        point = torch.from_numpy(z)
        # Not torch.func: it loads the compiler Triton, if there, whose LLVM crashes beside the software renderer's.
        policy = torch.autograd.functional.jacobian(self._policy, point).numpy()
        with torch.no_grad():
            y = self._policy(point).numpy()[S:]
        both = InitializeAutoDiff(np.concatenate((z[S:], y)))[:, 0]
        gradient = ExtractGradient(self._command_ad(both[:size], both[size:]))
        lower = gradient[:, size:] @ policy[S:]
        lower[:, S:] += gradient[:, :size]
        return np.vstack((policy[:S], lower))

    def difference_jacobian(self, z: np.ndarray) -> np.ndarray:
        """The same by central differences of the map."""
        offsets = DIFFERENCE * np.eye(len(z))
        return np.column_stack([(self(z + offset) - self(z - offset)) / (2 * DIFFERENCE) for offset in offsets])

    def _policy(self, z: torch.Tensor) -> torch.Tensor:
        """z to [c+, clipped posture prediction], differentiable."""
        c, m = z[: self.state_size], z[self.state_size :]
        y, after = self.rnn.step(torch.cat((m, self._features))[None], c[None])
        return torch.cat((after[0], y[0, : self.posture_size].clamp(-1.0, 1.0)))


def _command_of(law: System) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """m+ as a function of m and y, in the scalar type of `law`."""
    context = law.CreateDefaultContext()
    law.GetInputPort("alpha").FixValue(context, np.zeros(1))

    def command(posture: np.ndarray, prediction: np.ndarray) -> np.ndarray:
        law.GetInputPort("posture").FixValue(context, posture)
        law.GetInputPort("predicted_posture").FixValue(context, prediction)
        return law.GetOutputPort("desired_posture").Eval(context).copy()

    return command
