"""The value net's update, computed once more with NumPy from the checkpoints before and after it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from .burnpack import read_burnpack
from .command_line import ITERATION, TINY, dappo_batch, metrics

Array = NDArray[np.float64]
LAYERS = ("layers.0.weight", "layers.0.bias", "layers.1.weight", "layers.1.bias")
LEARNING_RATE = 3e-3


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train for two iterations, each with a single value minibatch, whose order then does not matter."""
    folder = tmp_path_factory.mktemp("value") / "run"
    settings = ("checkpoint.every=1", "checkpoint.keep=2", "ppo.value_epochs=1", "ppo.symmetry=false")
    settings += ("ppo.value_minibatch_size=100000", f"ppo.value_learning_rate={LEARNING_RATE}")
    dappo_batch("train", *TINY, *settings, "--steps", str(2 * ITERATION), "--run", folder)
    return folder


def checkpoint(run: Path, iteration: int) -> dict[str, Any]:
    folder = run / "checkpoints" / f"{iteration:08}"
    names = ("value.bpk", "value_adam.bpk", "value_batch.bpk")
    return {name: read_burnpack(folder / name) for name in names}


def array(tensor: tuple[str, list[int], bytes]) -> Array:
    kind, shape, data = tensor
    assert kind == "F32"
    return np.frombuffer(data, np.float32).reshape(shape).astype(np.float64)


def loss_and_gradients(net: dict[str, Array], obs: Array, returns: Array) -> tuple[float, dict[str, Array]]:
    """Mean squared error of a tanh net with one hidden layer, differentiated by hand."""
    weight_0, bias_0, weight_1, bias_1 = (net[name] for name in LAYERS)
    hidden = np.tanh(obs @ weight_0 + bias_0)
    error = hidden @ weight_1 + bias_1 - returns
    d_out = 2.0 * error / len(error)
    d_hidden = d_out @ weight_1.T * (1.0 - hidden**2)
    gradients = (obs.T @ d_hidden, d_hidden.sum(0), hidden.T @ d_out, d_out.sum(0))
    return float(np.mean(error**2)), dict(zip(LAYERS, gradients, strict=True))


def adam(before: dict[str, Any], name: str, gradient: Array) -> Array:
    """Kingma & Ba (2015), algorithm 1, with β₁ = 0.9, β₂ = 0.999, ε = 1e-5: the change of a parameter."""
    state = before["value_adam.bpk"]
    step = state["scalars"][f"{name}.momentum.time"]["UInt"] + 1
    first = 0.9 * array(state[f"{name}.momentum.moment_1"]) + 0.1 * gradient
    second = 0.999 * array(state[f"{name}.momentum.moment_2"]) + 0.001 * gradient**2
    unbiased = first / (1.0 - 0.9**step)
    return -LEARNING_RATE * unbiased / (np.sqrt(second / (1.0 - 0.999**step)) + 1e-5)


def stepped(before: dict[str, Any], obs: Array, returns: Array) -> tuple[float, dict[str, Array]]:
    net = {name: array(before["value.bpk"][name]) for name in LAYERS}
    loss, gradients = loss_and_gradients(net, obs, returns)
    return loss, {name: net[name] + adam(before, name, gradients[name]) for name in LAYERS}


def test_the_value_net_takes_one_adam_step_on_the_current_and_the_previous_batch(run: Path) -> None:
    before, after = checkpoint(run, 1), checkpoint(run, 2)
    # The batch of an update is stored with the checkpoint behind it: here the current and the previous one.
    batches = [after["value_batch.bpk"], before["value_batch.bpk"]]
    obs = np.concatenate([array(batch["obs"]) for batch in batches])
    returns = np.concatenate([array(batch["returns"]) for batch in batches])
    assert len(obs) == 2 * ITERATION
    loss, expected = stepped(before, obs, returns)
    assert metrics(run)[1]["value_loss"] == pytest.approx(loss, rel=1e-5)
    got = {name: array(after["value.bpk"][name]) for name in LAYERS}
    for name in LAYERS:
        # Adam divides small gradients by their own size, so single entries keep fewer digits than f32 has.
        np.testing.assert_allclose(got[name], expected[name], atol=0.01 * LEARNING_RATE)
    # The same computation on the current batch alone is not what happened.
    _, alone = stepped(before, obs[:ITERATION], returns[:ITERATION])
    changes = [np.abs(alone[name] - got[name]).max() for name in LAYERS]
    assert max(changes) > 0.1 * LEARNING_RATE
