"""A record made by hand, for tests of what reads records."""

import numpy as np

from diagrams.episodes.record import PICTURE_EVERY, Record


def recorded_run(n=120, seed=0):
    """Ticks `n`; disturbed from 39 to 50, alpha 1 from 41 to 90; picture p shows the grey value p."""
    ticks, rng = np.arange(n), np.random.default_rng(seed)
    looked_at = np.arange(0, n, PICTURE_EVERY)
    return Record(
        time=0.1 * ticks, posture=np.cumsum(rng.normal(size=(n, 8)), axis=0) * 0.01,
        rnn_step=0.01 * rng.normal(size=(n, 8)), regulator_step=0.01 * rng.normal(size=(n, 8)),
        desired_posture=np.zeros((n, 8)), alpha=np.where((ticks > 40) & (ticks < 90), 1.0, 0.0),
        errors=np.ones((n, 11)), hidden_state=rng.normal(size=(n, 5)) * [5, 3, 2, 0.1, 0.1],
        network_input=np.full((n, 38), 0.25), predicted_features=np.full((n, 30), 0.75),
        active=(ticks > 38) & (ticks < 50), can_poses=np.zeros((n, 14)),
        signals=np.zeros((n, 7)), tick_seconds=np.full(n, 0.01), picture_ticks=looked_at,
        pictures=np.tile(np.arange(len(looked_at), dtype=np.uint8)[:, None, None, None], (1, 112, 112, 3)),
        events=[
            (0.0, "subtask 1: pick the can"),
            (3.9, "the experimenter disturbs the arm"),
            (4.1, "recall fails: switched to the LQR"),
        ],
    )  # fmt: skip
