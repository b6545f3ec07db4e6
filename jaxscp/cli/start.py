"""Entry point of the program. It sets the log level before JAX is imported."""

import os
import sys

INTERRUPTED = 130  # exit code of shells after Ctrl-C


def main() -> None:
    """Run the command line."""
    # XLA logs a warning of versions for every program that it loads from a cache.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    try:
        from jaxscp.cli.app import main as run

        run()
    except KeyboardInterrupt:  # of imports, which take seconds: commands have their own answer
        sys.exit(INTERRUPTED)
