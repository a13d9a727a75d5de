"""Small run folders, sweeps, diagnosers and traces, written by hand for tests of what reads them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

CLASSES = (("healthy", "none"), ("jammed_joint@0", "D1"), ("missing_toe@0", "D2"), ("missing_toe@1", "D2"))


def write_run(
    path: Path,
    *,
    seed: int = 0,
    aware: bool = True,
    rewards: Sequence[float] = (1.0, 2.0, 3.0, 4.0),
    forward_rewards: Sequence[float | None] = (1.0, None, 3.0, 5.0),
    encodings: Sequence[str] = (),
    total: int | None = None,
    errors: float | None = 0.5,
    classes: Sequence[tuple[str, str]] = CLASSES,
    trackings: Sequence[float] | None = None,
    robot: str = "ant",
    more: str = "",
) -> Path:
    """Write a run with an iteration of 100 env steps for each forward reward.

    It is evaluated in some damage classes, given by name and group, with a reward each.
    Iteration i has i episodes, a fall rate of i / 10, and takes 2 s for the rollout and 3 s for the update.
    Every episode of the evaluation has 50 env steps, and `errors` are the standard errors of its rewards.
    With `trackings` of the classes the task has commands: their standard errors are 0.02, that of iteration i
    is 0.1 i, and evaluations after every second iteration find 0.2 i.
    """
    (path / "eval").mkdir(parents=True)
    total = 100 * len(forward_rewards) if total is None else total
    (path / "config.toml").write_text(
        f'robot = "{robot}"\nseed = {seed}\ntotal_steps = {total}\n{more}\n'
        f"[env]\nnum_envs = 4\nobserve_damage = {str(aware).lower()}\n"
        "[ppo]\ngamma = 0.99\n"
        '[[curriculum]]\nname = "all"\nbudget = 1.0\nmix = "uniform"\n'
    )
    meta = {"version": "0.1.0", "mujoco": "4.0.0", "backend": "lanes", "reward": "gym"}
    (path / "meta.json").write_text(json.dumps(meta))
    lines = [
        {
            "iteration": number,
            "env_steps": 100 * number,
            "stage": "all",
            "episodes": number if value is not None else 0,
            "forward_reward": value,
            "fall_rate": number / 10 if value is not None else None,
            "tracking": None if trackings is None else 0.1 * number,
            "evaluation_tracking": None if trackings is None or number % 2 else 0.2 * number,
            "rollout_seconds": 2.0,
            "update_seconds": 3.0,
        }
        for number, value in enumerate(forward_rewards, start=1)
    ]
    (path / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    for number, encoding in enumerate(("", *encodings)):
        rows = "".join(
            f"{index},{name},{group},8,{reward - number},{'' if errors is None else errors},50.0\n"
            for index, ((name, group), reward) in enumerate(zip(classes, rewards, strict=True))
        )
        file = f"per_class.{encoding}.csv" if encoding else "per_class.csv"
        header = "class,name,group,episodes,forward_reward,standard_error,episode_length\n"
        if trackings is not None:
            header = header.replace("\n", ",tracking,tracking_standard_error\n")
            shares = [f"{share - 0.1 * number:.4f},0.02" for share in trackings]
            rows = "".join(f"{row},{share}\n" for row, share in zip(rows.splitlines(), shares, strict=True))
        (path / "eval" / file).write_text(header + rows)
    return path


def write_adaptation(run: Path) -> None:
    """Add results of `adapt` to a run: 90 % of the oracle with adaptation, 50 % without, no PPO-Unaware."""
    header = (
        "class,name,episodes,ended_before_onset,false_alarms,detected,correct_first,correct_last,recovered,assumed,"
        "adapted,oracle,no_adaptation,unaware\n"
    )
    rows = (
        "0,healthy,10,0,1,0,0,10,0,healthy 10,70.0,70.0,70.0,\n"
        "1,jammed_joint@0,10,0,0,9,8,9,7,,60.0,80.0,50.0,\n"
        "2,missing_toe@0,10,0,0,10,9,10,8,,30.0,20.0,0.0,\n"
    )
    (run / "eval" / "adapt.csv").write_text(header + rows)


def write_sweep(path: Path) -> Path:
    """Write a sweep of two cells."""
    path.mkdir()
    (path / "table1.csv").write_text(
        "robot,timesteps,method,rollouts,seeds,accuracy_pct,sd_pct,validation_accuracy_pct,"
        "paper_accuracy_pct,paper_pm_pct\n"
        "ant,10,A,1000,3,91.25,0.50,91.00,78.20,1.11\n"
        "ant,10,A,2000,3,97.75,,97.00,81.40,0.60\n"
    )
    return path


def write_diagnoser(path: Path) -> Path:
    """Write a diagnoser of two classes that names 3 of 4 windows rightly."""
    (path / "eval").mkdir(parents=True)
    (path / "config.toml").write_text('method = "C"\ntimesteps = 50\nlstm = 32\nhead = "classes"\n')
    lines = [{"epoch": number, "validation_accuracy": 1 - 0.5 / number} for number in (1, 2)]
    (path / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (path / "eval" / "test.confusion.csv").write_text(
        "true\\diagnosed,healthy,broken\nhealthy,2,0\nbroken,1,1\n"
    )
    summary = {"accuracy": 0.75, "standard_error": 0.1, "calibration_error": 0.05}
    (path / "eval" / "test.json").write_text(json.dumps(summary))
    return path


def write_trace(path: Path, *, has_commands: bool = False) -> Path:
    """Write an episode of 60 steps with onset 20 and adaptation in step 30.

    With commands, tracking falls from 1 at the start by 0.01 a step.
    """
    rows = ["step,forward_velocity,damage,assumed,event" + ",tracking" * has_commands]
    for step in range(60):
        events = {25: "suspected", 30: "diagnosed broken (0.97); adapted"}
        damage, assumed = ("broken" if step >= 20 else "healthy"), ("broken" if step >= 30 else "healthy")
        row = f"{step},{step / 10:.1f},{damage},{assumed},{events.get(step, '')}"
        rows.append(row + f",{1 - step / 100:.2f}" * has_commands)
    path.write_text("\n".join(rows) + "\n")
    return path
