"""Stage: the RGB model."""
