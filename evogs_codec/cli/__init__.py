"""The command line `evogs`: it parses, calls the library, and prints."""
