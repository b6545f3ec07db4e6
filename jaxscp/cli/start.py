"""Entry point of the program. It sets the log level before JAX is imported."""

import os


def main() -> None:
    """Run the command line."""
    # XLA logs a warning of versions for every program that it loads from a cache.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    from jaxscp.cli.app import main as run

    run()
