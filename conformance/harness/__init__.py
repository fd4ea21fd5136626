"""The harness: runs any decoder against the vectors and says whether it is right, and why not.

Standard library only, and nothing of the codec or of the oracle: it can be carried off and read on
its own. The contract that a decoder keeps is `conformance/README.md`.
"""
