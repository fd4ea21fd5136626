"""Benchmarks: the figures of the README and of `docs/figures.md`, remade by one command."""
