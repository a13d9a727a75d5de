"""The console script ``dappo-batch``: a wrapper of the command line in Rust."""

import os
import sys

from dappo_batch._core import run_cli


def main() -> None:
    """Run the command line and exit with its code."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            # The next file that is opened would get the number of a closed one, and receive the output.
            os.open(os.devnull, os.O_RDWR)
    try:
        code = run_cli(sys.argv[1:])
    except KeyboardInterrupt:
        code = 130  # Ctrl-C after the command has checked for it the last time
    sys.exit(code)
