"""Completion of `evogs` in shells: scripts that `python -m tools.completions` makes."""
