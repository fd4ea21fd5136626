"""The bytes of a stream: header, chunks, directory, packets, frames, planes."""
