"""The networks of Table I and the recall heads, as torch modules."""

from models.registry import Registry

NETWORKS: Registry = Registry(
    "network",
    {"lstm": "models.networks.rnn:LSTM", "gru": "models.networks.rnn:GRU", "mtrnn": "models.networks.rnn:MTRNN"},
)
