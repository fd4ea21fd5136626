"""Other files: `.ply`, `.tree.npz`, JSON; how files are opened and replaced."""
