"""`python -m conformance.fuzzing`: random and damaged streams, on which all decoders must agree."""

import sys

from conformance.fuzzing.cli import main

if __name__ == "__main__":
    sys.exit(main())
