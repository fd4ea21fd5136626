"""`python -m tools.bench`: size, accuracy, time and memory beside other formats."""

import sys

from tools.bench.cli import main

sys.exit(main())
