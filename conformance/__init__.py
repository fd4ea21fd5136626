"""The conformance suite: cases, vectors, and the runner for any decoder."""
