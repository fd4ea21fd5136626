"""What surrounds training: checkpoints, progress, memory, hardware."""
