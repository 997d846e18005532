"""The stage structure from motion: RGB poses and sparse points of a capture."""
