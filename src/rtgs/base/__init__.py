"""What every other room uses: errors, events, progress, threads, files, JSON, compilation."""
