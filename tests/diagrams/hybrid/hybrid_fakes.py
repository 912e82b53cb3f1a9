"""A record, an outcome and a policy made by hand."""

from dataclasses import replace

import numpy as np
import torch

from diagrams.episodes.episode import Outcome
from diagrams.episodes.record import Record
from models.networks.recall import RecallHeads
from models.networks.rnn import make_rnn

FEATURES = np.linspace(-0.5, 0.5, 30)

OUTCOME = Outcome(
    seed=1, rnn="lstm", detector="recall", disturbance="A", can_xy=(0.5, 0.0), vacant="left", picked=True, placed=True,
    home=True, success=True, switched=True, detection_delay_s=None, false_switches=0, returned=True, resumed=True,
    switch_success=True, paper_switch_success=True, alpha_max_before=0.0, return_s=None, resume_s=None, failure=None,
    switch_failure=None, sim_seconds=40.0,
)  # fmt: skip


def make_record(alpha):
    """A tick for each value of alpha; postures and steps at random."""
    n = len(alpha)
    rng = np.random.default_rng(0)
    return Record(
        time=0.1 * np.arange(n), posture=rng.normal(size=(n, 8)), rnn_step=rng.normal(size=(n, 8)),
        regulator_step=np.zeros((n, 8)), desired_posture=np.zeros((n, 8)), alpha=np.array(alpha, float),
        errors=np.ones((n, 11)), hidden_state=np.full((n, 4), 0.5), features=np.zeros((n, 3)),
        predicted_features=np.zeros((n, 3)), active=np.zeros(n, bool), can_poses=np.zeros((n, 14)),
        picture_ticks=np.zeros(0, int), pictures=np.zeros((0, 112, 112, 3), np.uint8),
        events=[(0.1, "something")],
    )  # fmt: skip


def small_policy(stored, name):
    """The stored policy with another untrained network."""
    torch.manual_seed(1)
    rnn = make_rnn(name).eval()
    return replace(stored, rnn=rnn, recall=RecallHeads(rnn.state_size, 8))
