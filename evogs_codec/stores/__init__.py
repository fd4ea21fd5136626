"""The bytes of files wherever they are: given, on the disk, or behind a URL."""
