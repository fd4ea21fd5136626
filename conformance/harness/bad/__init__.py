"""Deliberately bad decoders, and good ones, that the harness must judge as `expected.json` says.

They know the right answers from the suite they are asked (`right`), so that each has exactly one
thing wrong with it. Standard library only.
"""
