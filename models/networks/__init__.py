"""The networks of Table I and the recall heads, as torch modules."""

from models.registry import Registry

NETWORKS: Registry = Registry(
    "network",
    {"lstm": "models.networks.rnn:LSTM", "gru": "models.networks.rnn:GRU", "mtrnn": "models.networks.rnn:MTRNN"},
)


def network_label(spec: str) -> str:
    """The short name of the network that `spec` names, by which its files are found.

    A network that was trained elsewhere needs no class here: its name is its file's.
    """
    return NETWORKS.label(spec) if ":" in spec else spec
