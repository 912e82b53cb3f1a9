"""Demonstrations on disk, the sequences cut from them, their augmentation and scaling; tapes of runs."""
