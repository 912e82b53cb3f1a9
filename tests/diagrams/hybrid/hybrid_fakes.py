"""Features and a policy made by hand."""

from dataclasses import replace

import numpy as np
import torch

from models.networks.recall import RecallHeads
from models.networks.rnn import make_rnn

FEATURES = np.linspace(-0.5, 0.5, 30)


def small_policy(stored, name):
    """The stored policy with another untrained network."""
    torch.manual_seed(1)
    rnn = make_rnn(name).eval()
    return replace(stored, rnn=rnn, recall=RecallHeads(rnn.state_size, 8))
