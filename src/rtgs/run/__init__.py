"""A run: its folder, its stages, and what is made of it."""
