"""The command `evogs`, also as `python -m evogs`, which an interrupt ends without a traceback.

While libraries are imported, most of the first second, and while Python ends, Ctrl-C would show a
traceback from the middle of a library. There the system's own way ends the process: nothing is
written yet, or all is. In between a command cleans up and says in one line that it was interrupted.
"""

from __future__ import annotations

import os
import signal
import sys

__all__ = ["main"]


def main() -> int:
    """Run the command that the arguments of the process name; returns the exit code."""
    # NumPy's products are small ones here: threads of theirs only wait for one another.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        # Somebody decided otherwise: behind `nohup`, or in a script's background, it is ignored.
        from evogs_codec.cli.commands import main as run_all

        return run_all()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from evogs_codec.cli.commands import parse, run

    args = parse()
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        return run(args)
    except KeyboardInterrupt:  # between two lines of this function
        return 130
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    sys.exit(main())
