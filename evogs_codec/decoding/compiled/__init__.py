"""The arithmetic of decoding, compiled with numba: identical integers, no verdicts."""
