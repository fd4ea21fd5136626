"""Tools around the codec: benchmarks, generated tables, photographs of the shipped scene."""
