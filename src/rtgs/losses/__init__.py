"""Losses of two pictures."""
