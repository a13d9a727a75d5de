"""Trainings, and tests of pytest's, in separate processes."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dappo_batch.runs.run import read_lines

from ..processes import DAPPO_BATCH

__all__ = ["pytest_summary", "training"]


def training(flags: Sequence[str], forward_reward: float, seconds: float) -> dict[str, Any]:
    """Train until the budget, the forward reward or the time limit is reached.

    Returns
    -------
    dict
        ``env_steps``, ``seconds``, ``steps_per_second`` without start and evaluation, ``rollout_seconds``,
        ``update_seconds``, ``forward_reward`` (the last), ``reached`` (env steps and seconds until
        `forward_reward`), ``diverged``.
    """
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        process = subprocess.Popen([*DAPPO_BATCH, "train", "--run", str(run), *flags])
        reached = None
        while process.poll() is None and time.monotonic() - start < seconds and reached is None:
            time.sleep(0.5)
            lines = read_lines(run / "metrics.jsonl")
            reached = _reached(lines, forward_reward, time.monotonic() - start)
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            code = process.wait(timeout=20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
        lines = read_lines(run / "metrics.jsonl")
    forward = [line["forward_reward"] for line in lines if line["forward_reward"] is not None]
    rollout, update = (sum(line[f"{part}_seconds"] for line in lines) for part in ("rollout", "update"))
    env_steps = lines[-1]["env_steps"] if lines else 0
    return {
        "ok": code in (0, 130) and bool(lines),
        "exit_code": code,
        "env_steps": env_steps,
        "seconds": time.monotonic() - start,
        "steps_per_second": round(env_steps / (rollout + update)) if lines else None,
        "rollout_seconds": rollout,
        "update_seconds": update,
        "forward_reward": forward[-1] if forward else None,
        "reached": reached,
        "diverged": sum(line["diverged"] for line in lines),
    }


def _reached(lines: list[dict[str, Any]], reward: float, seconds: float) -> dict[str, float] | None:
    for line in lines:
        if (line["forward_reward"] or 0.0) >= reward:
            return {"env_steps": line["env_steps"], "seconds": seconds}
    return None


def pytest_summary(
    arguments: Sequence[str], selected: str, environment: Mapping[str, str], seconds: float
) -> dict[str, Any]:
    """Run tests, those which `selected` matches if it is not empty, if pytest is installed."""
    if importlib.util.find_spec("pytest") is None:
        return {"skipped": "pytest is not installed"}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
    command += ["-k", selected] if selected else []
    try:
        done = subprocess.run(
            command,
            env=os.environ | environment,
            capture_output=True,
            text=True,
            timeout=max(seconds, 0.0),
            check=False,
        )
    except subprocess.TimeoutExpired:
        return {"skipped": f"the tests took longer than {seconds:.0f} s"}
    lines = done.stdout.strip().splitlines()
    return {
        "ok": done.returncode == 0,
        "summary": lines[-1] if lines else done.stderr[-300:],
        "failed": [line for line in lines if line.startswith(("FAILED", "ERROR"))],
    }
