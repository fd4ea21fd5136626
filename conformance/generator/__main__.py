"""`python -m conformance.generator`: make the vectors, or check that they are as made."""

from conformance.generator.generate import main

main()
