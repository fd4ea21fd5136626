"""`evogs view`: serves the page of `tools/web/viewer`, and the scenes that it shows."""
