"""The tables behind `rtgs experiment`."""
