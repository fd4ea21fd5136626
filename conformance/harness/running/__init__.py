"""Running a decoder under test: processes, batches, what they answer, what is left of them."""
