"""`python -m conformance.renders`."""

from conformance.renders.cli import main

raise SystemExit(main())
