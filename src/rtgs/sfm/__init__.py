"""Stage: RGB poses and sparse points."""
