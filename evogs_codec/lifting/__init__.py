"""An evolution tree under an existing set of splats: pair, merge, repeat."""
