"""Stage: scores on held-out views."""
