"""The console script ``dappo-batch``: a shim over the command line written in Rust."""

import os
import sys

from dappo_batch._core import run_cli


def main() -> None:
    """Run the command line and leave with its exit code."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            # A closed one would be given to the next file that is opened, and what is printed would go there.
            os.open(os.devnull, os.O_RDWR)
    sys.exit(run_cli(sys.argv[1:]))
