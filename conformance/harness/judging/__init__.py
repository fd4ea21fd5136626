"""What an answer of a decoder is worth: comparison, diagnosis, families of vectors."""
