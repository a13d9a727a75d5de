"""Collecting pairs of robot and twin, or robots alone, and training diagnosers with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

from dappo_batch._checks import folder
from dappo_batch._core import ConfigError
from dappo_batch.commands.invoke import invoke
from dappo_batch.commands.options import Callback, Folder, RobotChanged, Simulation
from dappo_batch.outside_policy import Act
from dappo_batch.results import DiagnoserReport, EpochMetrics

__all__ = ["collect_pairs", "evaluate_diagnoser", "train_diagnoser"]


def collect_pairs(
    expert: Folder,
    out: Folder,
    *,
    rollouts: int,
    timesteps: int,
    act: Act | str | None = None,
    preset: str | None = None,
    policy: Folder | None = None,
    seed: int = 0,
    shard: str | None = None,
    robot_changed: RobotChanged | None = None,
    **simulation: Unpack[Simulation],
) -> list[Path]:
    """Record damaged robots and their healthy twins, or the robots alone.

    Parameters
    ----------
    expert
        Run folder of the expert, the policy that controls the robots.
    out
        Folder of the dataset; rollouts that it already contains are not collected again.
    rollouts
        Number of rollouts, each with its own initial state and all damage classes.
    timesteps
        Recorded steps of a rollout.
    act
        A function in the place of the expert, or its ``"module:function"``: a policy of another learner. It
        gets raw observations, float32 [N, O], those that the policy of `expert` gets, and returns actions,
        [N, A], which must depend on these observations alone.
    preset
        ``paper``, ``runtime``, ``residual`` or ``observation``: onset of the damage, and kind of twin, none
        with ``observation``. By default ``residual``, or ``observation`` for a robot that does not observe
        its whole state.
    policy
        Run folder of another policy that controls the robots until the damage is suspected.
    seed
        Seed of the rollouts.
    shard
        Part i of n, as ``"i/n"``; all parts can be written to one folder.
    robot_changed
        What to do if the robot file has changed since the training; see `RobotChanged`.
    **simulation
        See `Simulation`.

    Returns
    -------
    list of Path
        The files of the dataset, for ``numpy.load(path, mmap_mode="r")``: structured arrays with the fields
        in the guide to diagnosis.
    """
    target = folder(out, "out")
    arguments = {
        "expert": expert,
        "out": target,
        "rollouts": rollouts,
        "timesteps": timesteps,
        "act": act,
        "preset": preset,
        "policy": policy,
        "seed": seed,
        "shard": shard,
        "robot_changed": robot_changed,
        **simulation,
    }
    invoke("collect_pairs", arguments)
    return sorted(target.glob("rollouts-*.npy"))


def train_diagnoser(
    data: Folder,
    out: Folder,
    *,
    method: str | None = None,
    timesteps: int | None = None,
    rollouts: int | None = None,
    seed: int | None = None,
    head: str | None = None,
    threads: int | None = None,
    set: Mapping[str, Any] | None = None,
    callback: Callback | None = None,
) -> list[EpochMetrics]:
    """Train a diagnoser on a dataset of `collect_pairs` into a new folder.

    Parameters
    ----------
    data, out
        Folders of the dataset and of the training.
    method
        ``A``, ``B``, ``C`` or ``D``: input of the network.
    timesteps, rollouts
        Steps and rollouts of the data to use; by default all.
    seed
        Seed of split, weights and order.
    head
        ``classes`` or ``limbs``.
    threads
        Worker threads.
    set
        Any other setting, for example ``{"epochs": 20}``.
    callback
        Called with the metrics of each epoch.

    Returns
    -------
    list of EpochMetrics
        The metrics of each epoch.
    """
    arguments = {
        "data": data,
        "out": out,
        "method": method,
        "timesteps": timesteps,
        "rollouts": rollouts,
        "seed": seed,
        "head": head,
        "threads": threads,
        "set": set,
    }
    return [EpochMetrics.from_dict(found) for found in invoke("train_diagnoser", arguments, callback)]


def evaluate_diagnoser(
    *models: Folder,
    data: Sequence[Folder],
    policy: Folder | None = None,
    episodes: int | None = None,
    threads: int | None = None,
    robot_changed: RobotChanged | None = None,
) -> list[DiagnoserReport]:
    """Evaluate diagnosers on datasets with another seed than their training data.

    Parameters
    ----------
    *models
        Folders of `train_diagnoser`.
    data
        Folders of datasets.
    policy
        Run folder of a damage-aware policy, to measure the cost of misclassifications.
    episodes
        Episodes of each pair of true and diagnosed class, for `policy`.
    threads
        Worker threads.
    robot_changed
        What to do if the robot file of `policy` has changed since its training; see `RobotChanged`.

    Returns
    -------
    list of DiagnoserReport
        One for each model and dataset.
    """
    if episodes is not None and policy is None:
        raise ConfigError("episodes are those of a policy; also pass its run folder as policy")
    arguments = {
        "models": models,
        "data": data,
        "policy": policy,
        "episodes": episodes,
        "threads": threads,
        "robot_changed": robot_changed,
    }
    (found,) = invoke("evaluate_diagnoser", arguments)
    return [DiagnoserReport.from_dict(one) for one in found]
