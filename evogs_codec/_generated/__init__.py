"""Tables of the spec as code: faults, limits, registry. Made by `python -m tools.spec_tables`."""
