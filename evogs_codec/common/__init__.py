"""What every package may use: threads, buffers, Morton codes, text that is safe to print."""
