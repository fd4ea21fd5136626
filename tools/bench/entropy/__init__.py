"""Other entropy coders on the integers of streams: sizes and speeds (decision 0007)."""
