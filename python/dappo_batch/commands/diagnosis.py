"""Collecting pairs of robot and twin, and learning to tell the damage from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

from dappo_batch._checks import folder
from dappo_batch._core import ConfigError
from dappo_batch.commands.invoke import invoke
from dappo_batch.commands.options import Callback, Folder, RobotChanged, Simulation
from dappo_batch.results import DiagnoserReport, EpochMetrics

__all__ = ["collect_pairs", "evaluate_diagnoser", "train_diagnoser"]


def collect_pairs(
    expert: Folder,
    out: Folder,
    *,
    rollouts: int,
    timesteps: int,
    preset: str | None = None,
    walker: Folder | None = None,
    seed: int = 0,
    shard: str | None = None,
    robot_changed: RobotChanged | None = None,
    **simulation: Unpack[Simulation],
) -> list[Path]:
    """Record walks of damaged robots beside their healthy twins.

    Parameters
    ----------
    expert
        Run folder of the policy that walks.
    out
        Folder of the dataset; what is there already is not collected again.
    rollouts
        Walks a damage class, each with its own initial state.
    timesteps
        Recorded steps of a walk.
    preset
        ``paper``, ``runtime`` or ``residual``: when damage strikes and how the twin is led.
    walker
        Run folder of another policy that walks before the damage is noticed.
    seed
        Seed of the walks.
    shard
        Piece i of n, as ``"i/n"``; all pieces may go into one folder.
    robot_changed
        What to do where the robot file has changed since the training; see `RobotChanged`.
    **simulation
        See `Simulation`.

    Returns
    -------
    list of Path
        The files of the dataset, for ``numpy.load(path, mmap_mode="r")``: structured arrays with the fields
        that the guide to diagnosis lists.
    """
    target = folder(out, "out")
    arguments = {
        "expert": expert,
        "out": target,
        "rollouts": rollouts,
        "timesteps": timesteps,
        "preset": preset,
        "walker": walker,
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
        ``A``, ``B``, ``C`` or ``D``: what the network sees.
    timesteps, rollouts
        How much of the data is used; all if left out.
    seed
        Seed of split, weights and order.
    head
        ``classes`` or ``limbs``.
    threads
        Worker threads.
    set
        Any other setting, for example ``{"epochs": 20}``.
    callback
        Told the metrics of each epoch.

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
    """Test diagnosers on datasets of another seed than their training data.

    Parameters
    ----------
    *models
        Folders of `train_diagnoser`.
    data
        Folders of datasets.
    policy
        Run folder of a damage-aware policy: also measure what the mistakes cost it.
    episodes
        Episodes a pair of true and named class, for `policy`.
    threads
        Worker threads.
    robot_changed
        What to do where the robot file of `policy` has changed since its training; see `RobotChanged`.

    Returns
    -------
    list of DiagnoserReport
        One for each model and dataset.
    """
    if episodes is not None and policy is None:
        raise ConfigError("episodes are those of a policy; give its run folder as policy, too")
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
