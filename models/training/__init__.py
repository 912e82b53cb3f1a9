"""Trains the networks: `python -m models.training --help`."""
