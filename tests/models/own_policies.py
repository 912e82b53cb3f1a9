"""Policies as somebody else would write them, and something that is none."""

import numpy as np

from diagrams.world.configuration import World
from diagrams.world.scenario import load_world
from models.command_line import ROOT
from models.policy import Decision, Policy, Seen

DRIFT = 0.01  # rad a tick, of the first joint


class Drift(Policy):
    """No state, no prediction, no recall: where the arm is, and a little on."""

    name = "drift"
    initial_posture = World().initial_posture

    def act(self, seen: Seen, state: np.ndarray) -> Decision:
        assert (seen.picture, state.shape, seen.features.shape) == (None, (0,), (30,))
        return Decision(seen.posture + DRIFT * np.eye(8)[0])


class Looking(Policy):
    """Goes on by the mean of the picture's red, in thousandths of a rad."""

    name = "looking"
    initial_posture = World().initial_posture
    looks = True

    def act(self, seen: Seen, state: np.ndarray) -> Decision:
        assert seen.picture.shape == (112, 112, 3)
        return Decision(seen.posture + 1e-3 * seen.picture[..., 0].mean() / 255.0 * np.eye(8)[0])


class Remembering(Policy):
    """Its state is the last three postures; from it heads can learn to recall. Rests at the initial posture."""

    name = "remembering"
    initial_posture = World().initial_posture
    initial_state = np.tile(World().initial_posture, 3)

    def act(self, seen: Seen, state: np.ndarray) -> Decision:
        return Decision(self.initial_posture, np.append(seen.posture, state[:-8]), seen.features)


class Recalling(Remembering):
    """Recalls itself, and has its own eye."""

    name = "recalling"
    recalls, horizon, feature_size = True, 2, 1

    def encode(self, picture: np.ndarray) -> np.ndarray:
        return np.array([picture[..., 0].mean() / 255.0])

    def act(self, seen: Seen, state: np.ndarray) -> Decision:
        after = np.append(seen.posture, state[:-8])
        return Decision(self.initial_posture, after, seen.features, after[8:].reshape(2, 8))


class NoPolicy:
    name = "no-policy"


class Nowhere(Drift):
    name = "nowhere"
    initial_posture = None


class Abroad(Drift):
    """For the iiwa."""

    name = "abroad"
    initial_posture = load_world(ROOT / "sdf" / "iiwa.world.yaml").initial_posture
    metadata = {"world": {"models": "iiwa.dmd.yaml", "period": 0.1}}  # noqa: RUF012


class Curious(Drift):
    """Answers by the features."""

    name = "curious"

    def act(self, seen: Seen, state: np.ndarray) -> Decision:
        return Decision(seen.posture + DRIFT * seen.features[0])


class WithArgument(Drift):
    def __init__(self, file):
        self.file = file


class WithoutAct(Policy):
    name = "without-act"
    initial_posture = World().initial_posture
