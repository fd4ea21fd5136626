"""`python -m conformance.harness`."""

import sys

from conformance.harness.cli import main

sys.exit(main())
