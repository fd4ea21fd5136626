"""Tools around the codec: scenes, tables, figures, benchmarks, the viewer."""
