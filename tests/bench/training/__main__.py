"""``python -m tests.bench.training``."""

import argparse
from collections.abc import Sequence

from ..entry import print_report
from . import run


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, and print the report."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.training",
        description="Env steps per second of PPO training on the healthy Ant, compared with other libraries.",
        argument_default=argparse.SUPPRESS,
    )
    add = parser.add_argument
    add("--envs", dest="num_envs", type=int, metavar="N", help="environments [default: 16]")
    add("--horizon", type=int, metavar="T", help="env steps of an iteration [default: 512]")
    add("--iterations", type=int, metavar="N", help="iterations of a sample [default: 3]")
    add("--threads", type=int, metavar="N", help="threads of each trainer [default: all cores]")
    print_report(run, parser, argv)


if __name__ == "__main__":
    main()
