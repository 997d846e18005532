"""Scores of two pictures."""
