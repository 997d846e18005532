"""Cameras whose files can be imported: one module a maker."""
