"""From packets to integers and floats: whole streams, prefixes, and bytes as they arrive."""
