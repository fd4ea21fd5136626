"""Scenes of other programs: `.spz`, `.sog`, `.splat`, `.ksplat`, glTF, compressed `.ply`."""
