"""`python -m tools.bench.paper`."""

import sys

from tools.bench.paper.cli import main

sys.exit(main())
