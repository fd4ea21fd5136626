"""What makes the vectors: cases, a builder of streams, and the files in `conformance/vectors`."""
