"""Decoders: an oracle in plain integers, one from the text alone, and the reference codec."""
