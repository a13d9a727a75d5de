"""The command line of ``dappo-batch bench``: three benchmarks, and which options each of them takes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

__all__ = ["options", "parse"]

_STEPS, _TRAINING, _DIAGNOSER = "`dappo-batch bench`", "--training", "--diagnoser"

# Parameters of each benchmark's `run`, by the name of the option that sets it.
_PARAMETERS = {
    _STEPS: {
        "robot": "robot",
        "envs": "num_envs",
        "threads": "threads",
        "seconds": "seconds",
        "rounds": "rounds",
        "no_learner": "learner",
    },
    _TRAINING: {
        "envs": "num_envs",
        "horizon": "horizon",
        "iterations": "iterations",
        "threads": "threads",
        "seconds": "seconds",
        "rounds": "rounds",
    },
    _DIAGNOSER: {
        "robot": "robot",
        "minibatch": "minibatches",
        "timesteps": "timesteps",
        "rollouts": "rollouts",
        "epochs": "epochs",
        "threads": "threads",
        "seconds": "seconds",
        "rounds": "rounds",
    },
}


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Parse the arguments behind ``bench``; leaves the process with exit code 2 if they are wrong.

    What was not given is ``None``, so that the function that measures has the only default.
    """
    parser = _parser()
    arguments = parser.parse_args(argv)
    chosen = _chosen(arguments)
    for name in sorted({name for names in _PARAMETERS.values() for name in names}):
        if getattr(arguments, name) is not None and name not in _PARAMETERS[chosen]:
            takers = [benchmark for benchmark, names in _PARAMETERS.items() if name in names]
            option = f"--{name.replace('_', '-')}"
            parser.error(f"{chosen} takes no {option}; it belongs to {' and '.join(takers)}")
    if chosen != _DIAGNOSER and arguments.threads is not None:
        if len(arguments.threads) > 1:
            parser.error(f"several numbers of --threads belong to {_DIAGNOSER}")
        (arguments.threads,) = arguments.threads
    return arguments


def options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what was given as arguments of the chosen benchmark's `run`."""
    parameters = _PARAMETERS[_chosen(arguments)]
    given = {parameter: getattr(arguments, name) for name, parameter in parameters.items()}
    return {parameter: value for parameter, value in given.items() if value is not None}


def _chosen(arguments: argparse.Namespace) -> str:
    if arguments.training:
        return _TRAINING
    return _DIAGNOSER if arguments.diagnoser else _STEPS


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="dappo-batch bench",
        description="Env steps per second and processor time of this package beside other simulators, "
        "interleaved in one process; with --training, those of complete training beside other libraries; "
        "with --diagnoser, samples per second of training the diagnoser beside PyTorch.",
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument(
        "--training", action="store_true", help="measure rollout and update of PPO on the healthy Ant"
    )
    which.add_argument(
        "--diagnoser", action="store_true", help="measure the training of the self-diagnose network"
    )
    add = parser.add_argument
    add("--robot", metavar="NAME|FILE", help="robot to simulate or to diagnose [default: ant]")
    add("--envs", type=int, metavar="N", help="environments [default: 4096, with --training 16]")
    add("--horizon", type=int, metavar="T", help="with --training: env steps of an iteration [default: 512]")
    iterations = "with --training: iterations of a sample [default: 3]"
    add("--iterations", type=int, metavar="N", help=iterations)
    minibatch = "with --diagnoser: samples of a minibatch, one or several numbers [default: 64 256]"
    add("--minibatch", type=int, nargs="+", metavar="B", help=minibatch)
    add("--timesteps", type=int, metavar="T", help="with --diagnoser: steps of a window [default: 50]")
    rollouts = "with --diagnoser: rollouts to train on [default: 100]"
    add("--rollouts", type=int, metavar="N", help=rollouts)
    epochs = "with --diagnoser: epochs of a sample [default: 2]"
    add("--epochs", type=int, metavar="N", help=epochs)
    threads = "threads of each contender [default: all cores]; with --diagnoser one or several numbers "
    add("--threads", type=int, nargs="+", metavar="N", help=f"{threads} [default: 1 and all cores]")
    seconds = "least length of a sample, otherwise than by default of a sample of the machine [default: 2]"
    add("--seconds", type=float, metavar="S", help=seconds)
    add("--rounds", type=int, metavar="N", help="samples a contender, interleaved [default: 5]")
    # A flag that was not given is None, as every other option.
    no_learner = "leave out the training run"
    add("--no-learner", action="store_const", const=False, help=no_learner)
    add("--list", action="store_true", help="list the contenders and what they need")
    add("--json", action="store_true", help="print JSON")
    return parser
