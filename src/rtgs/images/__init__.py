"""Filters, pictures for people, and patterns that a sensor draws."""
