"""Detectors beside each other: tapes of runs, their scores on them, what an alarm was worth."""
