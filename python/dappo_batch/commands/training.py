"""Training a policy, and evaluating it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

from dappo_batch._checks import folder
from dappo_batch.commands.invoke import invoke
from dappo_batch.commands.options import Callback, Folder, RobotChanged, Simulation, TrainingOptions, renamed
from dappo_batch.outside_policy import Act
from dappo_batch.results import EvaluationReport
from dappo_batch.runs import Run, load_run

__all__ = ["evaluate", "resume", "train"]


def train(run: Folder, *, callback: Callback | None = None, **options: Unpack[TrainingOptions]) -> Run:
    """Train a policy into a new run folder and evaluate it.

    Parameters
    ----------
    run
        The run folder; it must not contain a run.
    callback
        Called with the metrics of each iteration.
    **options
        See `TrainingOptions`.

    Returns
    -------
    Run
        What `load_run` reads from the folder. A run that the callback stopped has no evaluation.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range, or the folder contains a run.
    SimulationError
        If the simulation cannot be set up, or the training diverges; see `resume`.
    """
    invoke("train", {"run": folder(run, "run"), **renamed(options)}, callback)
    return load_run(run)


def resume(
    run: Folder,
    *,
    total_steps: int | None = None,
    threads: int | None = None,
    learner: str | None = None,
    njmax: int | None = None,
    nconmax: int | None = None,
    set: Mapping[str, Any] | None = None,
    robot_changed: RobotChanged | None = None,
    callback: Callback | None = None,
    steps: int | None = None,
) -> Run:
    """Resume a training from its newest checkpoint.

    Parameters
    ----------
    run
        The run folder.
    total_steps
        Env steps of the whole run, to change its budget.
    threads
        Worker threads; by default the number of cores.
    learner
        ``cpu`` or ``gpu``: where the networks are computed.
    njmax, nconmax
        On a GPU, buffer sizes from now on: constraints of each env, and contacts as an average over the envs.
    set
        Settings that change from now on, for example ``{"ppo.learning_rate": 1e-4}``. The run folder records
        them. Settings that determine the checkpoints, such as ``ppo.hidden``, cannot change.
    robot_changed
        If the robot file has changed since the training: ``"use-run"`` uses the copy of the robot in the run
        folder, ``"use-file"`` the current file, which then replaces the copy.
    callback
        Called with the metrics of each iteration.
    steps
        Old name of `total_steps`.

    Returns
    -------
    Run
        What `load_run` reads from the folder.

    Raises
    ------
    ConfigError
        If the folder contains no run, a setting cannot change, or the robot file has changed and
        `robot_changed` is not given.
    CheckpointError
        If its checkpoint cannot be read.
    SimulationError
        If the training diverges. The newest checkpoint is kept; `set` can lower the learning rates.
    """
    budgets = {"total_steps": total_steps, "steps": steps}
    arguments = {
        "resume": folder(run, "run"),
        **renamed({name: budget for name, budget in budgets.items() if budget is not None}),
        "threads": threads,
        "learner": learner,
        "njmax": njmax,
        "nconmax": nconmax,
        "set": set,
        "robot_changed": robot_changed,
    }
    invoke("train", arguments, callback)
    return load_run(run)


def evaluate(
    *runs: Folder,
    compare: Sequence[Folder] = (),
    act: Act | str | None = None,
    encoding: str = "true",
    episodes: int | None = None,
    seed: int | None = None,
    set: Mapping[str, Any] | None = None,
    robot_changed: RobotChanged | None = None,
    **simulation: Unpack[Simulation],
) -> EvaluationReport:
    """Evaluate policies on every damage class, and write tables to ``eval/`` of their runs.

    Parameters
    ----------
    *runs
        Run folders of one learner with different seeds.
    compare
        Run folders of another learner.
    act
        Function that chooses the actions in the place of the policy of `runs`, which is one run: a policy of
        another learner. It gets the raw observations that the run's policy gets, float32[N, O] of N robots,
        once in each env step, and returns actions, [N, A]. All episodes begin with its first call; before
        that its method ``reset()``, if it has one, is called. Also ``"module:function"``.
    encoding
        Damage code that the policies of `runs` receive: ``true``, ``zero``, ``wrong`` or ``random``.
    episodes
        Episodes of each damage class; by default that of the run's configuration.
    seed
        Seed of the initial states.
    set
        Settings of the episodes that differ from those of the training, for example
        ``{"damage.severity": 0.5}``: those of ``damage``, ``env.max_episode_steps`` and ``env.physics``.
    robot_changed
        What to do if the robot file has changed since the training; see `RobotChanged`.
    **simulation
        See `Simulation`.

    Returns
    -------
    EvaluationReport
        ``runs`` and ``others``, evaluations by class and group, and ``comparison``, or None.
    """
    arguments = {
        "runs": runs,
        "compare": compare,
        "act": act,
        "encoding": encoding,
        "episodes": episodes,
        "seed": seed,
        "set": set,
        "robot_changed": robot_changed,
        **simulation,
    }
    (found,) = invoke("evaluate", arguments)
    return EvaluationReport.from_dict(found)
