"""Other ways to a scale or to thermal views, rows of Table III."""
