"""`python -m tools.bench.coded`."""

import sys

from tools.bench.coded.cli import main

if __name__ == "__main__":
    sys.exit(main())
