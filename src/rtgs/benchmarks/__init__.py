"""The tables behind `rtgs bench`."""
