"""A policy with one hidden layer, read from its checkpoint and computed with NumPy."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .burnpack import read_burnpack

Array = NDArray[Any]


def mean_actions(run: Path, obs: Array, codes: Array | float = 0.0) -> Array:
    """Compute mean actions for observations without damage code, [N, O], and codes, [N, C]; 0 is healthy."""
    checkpoint = sorted((run / "checkpoints").iterdir())[-1]
    normalizer = tomllib.loads((checkpoint / "learner.toml").read_text())["normalizer"]
    mean = np.array(normalizer["mean"])
    variance = np.array(normalizer["squares"]) / normalizer["count"]
    tensors = read_burnpack(checkpoint / "policy.bpk")
    layer = [
        {
            name: np.frombuffer(tensors[key][2], np.float32).reshape(tensors[key][1]).astype(np.float64)
            for name, key in ((name, f"mean.layers.{index}.{name}") for name in ("weight", "bias"))
        }
        for index in range(2)
    ]
    scaled = np.clip((obs - mean) / np.sqrt(variance + 1e-8), -10, 10)
    of_obs, of_code = np.split(layer[0]["weight"], [len(mean)])
    of_damage = normalizer["code_scale"] * np.broadcast_to(codes, (*obs.shape[:-1], len(of_code))) @ of_code
    hidden = np.tanh(scaled @ of_obs + of_damage + layer[0]["bias"])
    return np.asarray(hidden @ layer[1]["weight"] + layer[1]["bias"])
