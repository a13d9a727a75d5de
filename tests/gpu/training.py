"""A training of the Ant on the device, and the tests of the kernels, in separate processes."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from dappo_batch.runs.run import read_lines

from ..processes import DAPPO_BATCH
from .scale import Scale

__all__ = ["kernel_tests", "training"]

_KERNEL_TESTS = Path(__file__).parent.parent / "kernels"


def training(scale: Scale, device: str, run: Path, seconds: float) -> dict[str, Any]:
    """Train until the budget, the reward or the time limit is reached.

    Returns
    -------
    dict
        ``env_steps``, ``seconds``, ``rollout_seconds``, ``update_seconds``, ``forward_reward`` (the last),
        ``reached`` (env steps and seconds until `Scale.forward_reward`), ``diverged``.
    """
    metrics = run / "metrics.jsonl"
    flags = ("--device", device, "--run", str(run), *scale.training)
    start = time.monotonic()
    with (run.parent / "training.log").open("w") as log:
        process = subprocess.Popen([*DAPPO_BATCH, "train", *flags], stdout=log, stderr=log)
        reached = None
        while process.poll() is None and time.monotonic() - start < seconds and reached is None:
            time.sleep(0.5)
            reached = _reached(read_lines(metrics), scale.forward_reward, time.monotonic() - start)
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            code = process.wait(timeout=60.0)
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
    lines = read_lines(metrics)
    forward = [line["forward_reward"] for line in lines if line["forward_reward"] is not None]
    return {
        "ok": code in (0, 130) and bool(lines),
        "exit_code": code,
        "env_steps": lines[-1]["env_steps"] if lines else 0,
        "seconds": time.monotonic() - start,
        "rollout_seconds": sum(line["rollout_seconds"] for line in lines),
        "update_seconds": sum(line["update_seconds"] for line in lines),
        "forward_reward": forward[-1] if forward else None,
        "reached": reached,
        "diverged": sum(line["diverged"] for line in lines),
    }


def _reached(lines: list[dict[str, Any]], reward: float, seconds: float) -> dict[str, float] | None:
    for line in lines:
        if (line["forward_reward"] or 0.0) >= reward:
            return {"env_steps": line["env_steps"], "seconds": seconds}
    return None


def kernel_tests(scale: Scale, seconds: float) -> dict[str, Any]:
    """Run the tests of the kernels on the device, if pytest is installed."""
    if importlib.util.find_spec("pytest") is None:
        return {"skipped": "pytest is not installed"}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(_KERNEL_TESTS)]
    command += ["-k", scale.tests] if scale.tests else []
    environment = os.environ | {"DAPPO_WARP_DEVICE": scale.device}
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=seconds, check=False
        )
    except subprocess.TimeoutExpired:
        return {"skipped": f"the tests took longer than {seconds:.0f} s"}
    lines = done.stdout.strip().splitlines()
    failed = [line for line in lines if line.startswith(("FAILED", "ERROR"))]
    return {
        "ok": done.returncode == 0,
        "summary": lines[-1] if lines else done.stderr[-300:],
        "failed": failed,
    }
