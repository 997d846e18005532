"""Experiments: the tables that `rtgs experiment` makes, of this method beside its rivals."""
