"""The loops of lifting, compiled with numba: the same trees as from numpy, to the bit.

Optional: without numba, and for few splats, the codec uses numpy. Sums have the order that they
have there, and logarithms and powers come from numpy for both, so that they are rounded alike.
"""
