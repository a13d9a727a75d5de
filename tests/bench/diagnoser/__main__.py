"""``python -m tests.bench.diagnoser``."""

import argparse
from collections.abc import Sequence

from ..entry import print_report
from . import run


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, and print the report."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.diagnoser",
        description="Samples per second of training the diagnoser, compared with PyTorch.",
        argument_default=argparse.SUPPRESS,
    )
    add = parser.add_argument
    add("--robot", metavar="NAME|FILE", help="robot to diagnose [default: ant]")
    minibatch = "samples of a minibatch, one or several numbers [default: 64 256]"
    add("--minibatch", dest="minibatches", type=int, nargs="+", metavar="B", help=minibatch)
    add("--timesteps", type=int, metavar="T", help="steps of a window [default: 50]")
    add("--rollouts", type=int, metavar="N", help="rollouts to train on [default: 100]")
    add("--epochs", type=int, metavar="N", help="epochs of a sample [default: 2]")
    threads = "threads of each trainer, one or several numbers [default: 1 and all cores]"
    add("--threads", type=int, nargs="+", metavar="N", help=threads)
    print_report(run, parser, argv)


if __name__ == "__main__":
    main()
