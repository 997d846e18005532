"""A page that a person can send: one file with the model, opened from disk without a server."""
