"""Stand-ins for the trained networks that know the teacher's motion by heart: the closed loop without weights.

They obey the same equations as the trained ones: all memory is in the hidden state, the prediction is the next
posture, the recall tells where the arm should have been, and under alpha = 1 the network goes on in its own
imagination.
"""

import numpy as np

from diagrams.episodes.episode import Episode
from diagrams.world.configuration import World
from diagrams.world.inverse_kinematics import HandKinematics
from diagrams.world.names import ARM_JOINTS, CAN_HALF_HEIGHT, SPOTS
from diagrams.world.station import PickPlaceStation
from diagrams.world.trajectory import subtask_commands
from models.data.scaling import MinMaxScaling

WAITING, PICKING, PLACING, PICKING_AGAIN = range(4)
# Where the can stands on the mat, seen from the camera; in the hand and on the shelf it is elsewhere. Columns and rows,
# pixels.
MAT_COLUMNS, MAT_ROWS = slice(0, 56), slice(58, 112)


class FakeEncoder:
    """Features: 1 (a picture was taken), 1 or 0 (the red can is on the mat or not), 0."""

    feature_size = 3

    def __init__(self):
        self.calls = 0

    def encode(self, rgb):
        self.calls += 1
        red, green, blue = np.moveaxis(rgb[MAT_ROWS, MAT_COLUMNS].astype(int), 2, 0)
        return np.array([1.0, float(np.count_nonzero((red > 90) & (green < 40) & (blue < 40)) > 5), 0.0])


class FakePolicy:
    """Plays the teacher's commands back by a tick counter.

    Hidden state: what it is doing (WAITING ...), the tick within that, and where the arm should have been at this tick
    and the `horizon` ticks before it. A can on the mat and closed fingers: it was taken from the hand.
    """

    posture_size, feature_size, horizon = ARM_JOINTS + 1, FakeEncoder.feature_size, 10
    state_size = 2 + (horizon + 1) * posture_size
    beta, gamma = 30.0, 60.0
    hash = name = "fake"

    def __init__(self, world: World):
        self._world = world
        self._hand = HandKinematics(world)
        station = PickPlaceStation(world, camera=False)
        self._spots = {name: station.spot(name) for name in SPOTS}
        self.initial_posture = world.initial_posture
        reach = np.append(np.deg2rad([90, 90, 90, 90, 90, 90, 90]), 0.06)
        self.scaling = MinMaxScaling(self.initial_posture - reach, self.initial_posture + reach)
        self.initial_state = np.concatenate(
            ([WAITING, 0], np.tile(self.scaling.scale(self.initial_posture), self.horizon + 1))
        )
        self.mean_errors = np.full(self.horizon + 1, 2e-6)
        self.inputs = []
        self._paths = {}

    def learn(self, episode: Episode) -> None:
        """What training would have taught it about the scene of `episode`."""

        def path(centre, subtask):
            rows = subtask_commands(self._world, self._hand, np.asarray(centre), subtask)
            away = np.flatnonzero(np.abs(rows - self.initial_posture)[:, :-1].max(axis=1) > 1e-9)
            # Without the dwells: at the initial posture it waits for what it sees.
            return self.scaling.scale(rows[away[0] : away[-1] + 2])

        self._paths = {
            PICKING: path([*episode.can_xy, CAN_HALF_HEIGHT], 1),
            PLACING: path(self._spots[episode.vacant], 2),
        }
        if episode.disturbance.can_moved_to is not None:
            self._paths[PICKING_AGAIN] = path([*episode.disturbance.can_moved_to, CAN_HALF_HEIGHT], 1)
        self.inputs = []

    def step(self, x, state):
        """See models.inference.Policy.step."""
        self.inputs.append(np.array(x))
        home = self.scaling.scale(self.initial_posture)
        posture, features = x[: self.posture_size], x[self.posture_size :]
        doing, tick = (int(v) for v in state[:2])
        if doing == WAITING and features[0] > 0.5:  # it sees the world, not its own imagination
            closed = posture[-1] < home[-1] - 0.3
            if features[1] > 0.5:
                doing = PICKING_AGAIN if closed and PICKING_AGAIN in self._paths else PICKING
            elif closed:
                doing = PLACING
            if doing != WAITING:
                tick = 0
        if doing == WAITING:
            here, goal = np.append(home[:-1], posture[-1]), np.append(home[:-1], posture[-1])
        else:
            path = self._paths[doing]
            here, goal = path[tick - 1] if tick else np.append(home[:-1], posture[-1]), path[tick]
            tick += 1
            if tick == len(path):
                doing, tick = WAITING, 0
        expected = np.concatenate((here, state[2 : -self.posture_size]))
        y, after = np.append(goal, np.zeros(self.feature_size)), np.append([doing, tick], expected)
        return y, after, after[2 + self.posture_size :].reshape(self.horizon, self.posture_size)
