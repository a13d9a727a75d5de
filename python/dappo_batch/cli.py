"""The console script ``dappo-batch``: a shim over the command line written in Rust."""

import sys

from dappo_batch._core import run_cli


def main() -> None:
    """Run the command line and leave with its exit code."""
    sys.exit(run_cli(sys.argv[1:]))
