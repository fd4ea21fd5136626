"""Trainable splats: tensors, blocks of a tree, growth, the optimiser, gradients."""
