"""Faults that know cans and plant bodies, the one list of all faults, and how one gets into a diagram."""
