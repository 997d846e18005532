"""What everything stands on: errors, progress, threads, JSON."""
