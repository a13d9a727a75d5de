"""The policy and the value net: normalised observations in, sampled actions, log-densities and values out.

They implement the same as ``frozen.rs`` and ``input.rs`` of ``rust/dappo-nn``. The learner trains on the host
and assigns its weights to arrays with fixed addresses, which a captured graph reads.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from . import philox

__all__ = ["Mlp", "Normalizer", "Policy"]

wp.set_module_options({"enable_backward": False})

LN_SQRT_TAU = wp.constant(wp.float64(0.5 * math.log(math.tau)))
HALF = wp.constant(wp.float64(0.5))

CLIP = 10.0  # bound of normalised observations, in standard deviations


@wp.kernel
def normalize(
    # Model:
    shift_in: wp.array[wp.float32],
    scale_in: wp.array[wp.float32],
    bound_in: wp.array[wp.float32],
    # In:
    mask_in: wp.array[wp.bool],
    obs_in: wp.array2d[wp.float32],
    # Out:
    input_out: wp.array2d[wp.float32],
) -> None:
    worldid, i = wp.tid()
    if mask_in[worldid]:
        value = (obs_in[worldid, i] - shift_in[i]) * scale_in[i]
        input_out[worldid, i] = wp.clamp(value, -bound_in[i], bound_in[i])


@wp.kernel
def dense(
    # Model:
    weight_in: wp.array2d[wp.float32],
    bias_in: wp.array[wp.float32],
    is_hidden: bool,
    # In:
    mask_in: wp.array[wp.bool],
    input_in: wp.array2d[wp.float32],
    # Out:
    output_out: wp.array2d[wp.float32],
) -> None:
    worldid, unit = wp.tid()
    if not mask_in[worldid]:
        return
    total = bias_in[unit]
    for i in range(weight_in.shape[0]):
        total += input_in[worldid, i] * weight_in[i, unit]
    if is_hidden:
        total = wp.tanh(total)
    output_out[worldid, unit] = total


@wp.kernel
def sample(
    # Model:
    log_std_in: wp.array[wp.float32],
    # In:
    key_in: wp.array[wp.uint64],
    step_in: wp.array[wp.uint64],
    mean_in: wp.array2d[wp.float32],
    # Out:
    noise_out: wp.array2d[wp.float32],
    action_out: wp.array2d[wp.float32],
) -> None:
    worldid, i = wp.tid()
    noise = wp.float32(philox.normal(key_in[worldid], step_in[0], philox.ACTION_NOISE, 0, i))
    noise_out[worldid, i] = noise
    action_out[worldid, i] = mean_in[worldid, i] + wp.exp(log_std_in[i]) * noise


@wp.kernel
def score(
    # Model:
    log_std_in: wp.array[wp.float32],
    # In:
    noise_in: wp.array2d[wp.float32],
    # Out:
    log_prob_out: wp.array[wp.float32],
) -> None:
    worldid = wp.tid()
    squares = wp.float64(0.0)
    constant = wp.float64(0.0)
    for i in range(noise_in.shape[1]):
        noise = wp.float64(noise_in[worldid, i])
        squares += noise * noise
        constant += wp.float64(log_std_in[i]) + LN_SQRT_TAU
    log_prob_out[worldid] = wp.float32(-HALF * squares - constant)


class Normalizer:
    """Shifts and scales observations; the identity until statistics are assigned.

    Parameters
    ----------
    obs_dim, code_length : int
        Length of an observation, and of the damage code at its end, which is only multiplied by a constant.
    """

    def __init__(self, obs_dim: int, code_length: int) -> None:
        self._tracked = obs_dim - code_length
        self.shift = wp.zeros(obs_dim, dtype=wp.float32)
        self.scale = wp.full(obs_dim, 1.0, dtype=wp.float32)
        self.bound = wp.full(obs_dim, math.inf, dtype=wp.float32)

    def assign(self, statistics: tuple[ArrayLike, ArrayLike] | None, code_scale: float = 1.0) -> None:
        """Set the statistics.

        Parameters
        ----------
        statistics : (mean, scale), arrays of shape [obs_dim - code_length], or None
            Mean and 1 / standard deviation of every entry before the code; with `None` they are left
            unchanged.
        code_scale : float
            Factor of the entries of the code.
        """
        shift, scale, bound = (array.numpy().copy() for array in (self.shift, self.scale, self.bound))
        tracked = slice(self._tracked)
        shift[tracked], scale[tracked], bound[tracked] = 0.0, 1.0, math.inf
        if statistics is not None:
            shift[tracked], scale[tracked] = statistics
            bound[tracked] = CLIP
        scale[self._tracked :] = code_scale
        for array, values in ((self.shift, shift), (self.scale, scale), (self.bound, bound)):
            array.assign(values)

    def apply(
        self, obs: wp.array2d[wp.float32], mask: wp.array[wp.bool], rows: wp.array2d[wp.float32]
    ) -> None:
        """Write the normalised observations of the selected worlds into `rows` [N, O]."""
        wp.launch(
            normalize, dim=obs.shape, inputs=[self.shift, self.scale, self.bound, mask, obs], outputs=[rows]
        )


class Mlp:
    """A multilayer perceptron: tanh after every hidden layer, a linear output layer.

    Parameters
    ----------
    num_worlds : int
        Rows of a batch, N.
    sizes : sequence of int
        Inputs, hidden layers and outputs.

    Attributes
    ----------
    parameters : wp.array of shape [P]
        All weights, layer after layer: the matrix [inputs, outputs] row by row, then the biases.
    output : wp.array of shape [N, outputs]
        Output of the last call of `forward`.
    """

    def __init__(self, num_worlds: int, sizes: Sequence[int]) -> None:
        layers = list(itertools.pairwise(sizes))
        self.parameters = wp.zeros(
            sum((inputs + 1) * outputs for inputs, outputs in layers), dtype=wp.float32
        )
        self._layers = []
        start = 0
        for inputs, outputs in layers:
            weight = self.parameters[start : start + inputs * outputs].reshape((inputs, outputs))
            start += inputs * outputs
            self._layers.append((weight, self.parameters[start : start + outputs]))
            start += outputs
        self._outputs = [wp.zeros((num_worlds, outputs), dtype=wp.float32) for _, outputs in layers]
        self.output = self._outputs[-1]

    def forward(self, rows: wp.array2d[wp.float32], mask: wp.array[wp.bool]) -> None:
        """Compute `output` for the selected rows of `rows` [N, inputs]."""
        for number, ((weight, bias), output) in enumerate(zip(self._layers, self._outputs, strict=True)):
            is_hidden = number + 1 < len(self._layers)
            wp.launch(dense, output.shape, inputs=[weight, bias, is_hidden, mask, rows], outputs=[output])
            rows = output


class Policy:
    """A diagonal Gaussian policy and its value net, for all worlds at once.

    Parameters
    ----------
    num_worlds, obs_dim, code_length, action_dim : int
        Sizes: N, O, length of the damage code in an observation, A.
    hidden : sequence of int
        Hidden layers of both nets.

    Attributes
    ----------
    normalizer : Normalizer
        Applied to the inputs of both nets.
    actor, critic : Mlp
        Mean of the action; value, in the learner's unit.
    log_std : wp.array of shape [A]
        Logarithm of the standard deviations.
    actions, log_probs : wp.array of shape [N, A] and [N]
        Sampled actions, unbounded, and their log-densities.
    """

    def __init__(
        self, num_worlds: int, obs_dim: int, code_length: int, action_dim: int, hidden: Sequence[int]
    ) -> None:
        self.normalizer = Normalizer(obs_dim, code_length)
        self.actor = Mlp(num_worlds, [obs_dim, *hidden, action_dim])
        self.critic = Mlp(num_worlds, [obs_dim, *hidden, 1])
        self.log_std = wp.zeros(action_dim, dtype=wp.float32)
        self.actions = wp.zeros((num_worlds, action_dim), dtype=wp.float32)
        self.log_probs = wp.zeros(num_worlds, dtype=wp.float32)
        self._noise = wp.zeros((num_worlds, action_dim), dtype=wp.float32)
        self._rows = wp.zeros((num_worlds, obs_dim), dtype=wp.float32)
        self._all_worlds = wp.full(num_worlds, True, dtype=wp.bool)

    @property
    def means(self) -> wp.array2d[wp.float32]:
        """Means of the actions, [N, A]."""
        return self.actor.output

    @property
    def values(self) -> wp.array2d[wp.float32]:
        """Values as of the last call of `act` or `evaluate`, [N, 1]."""
        return self.critic.output

    def assign(self, actor: NDArray[np.float32], critic: NDArray[np.float32], log_std: ArrayLike) -> None:
        """Set the weights: flat, as `Mlp.parameters` describes them, and the log-std [A]."""
        self.actor.parameters.assign(actor)
        self.critic.parameters.assign(critic)
        self.log_std.assign(np.asarray(log_std, dtype=np.float32))

    def act(self, obs: wp.array2d[wp.float32], keys: wp.array[wp.uint64], step: wp.array[wp.uint64]) -> None:
        """Sample an action for every observation [N, O].

        Parameters
        ----------
        obs : wp.array of shape [N, O]
            Raw observations.
        keys : wp.array of shape [N]
            Random keys of the exploration noise.
        step : wp.array of shape [1]
            Number of the step in the run: every (key, step) has different noise.
        """
        self.evaluate(obs, self._all_worlds)
        self.actor.forward(self._rows, self._all_worlds)
        wp.launch(
            sample,
            dim=self.actions.shape,
            inputs=[self.log_std, keys, step, self.means],
            outputs=[self._noise, self.actions],
        )
        wp.launch(
            score, dim=self.log_probs.shape, inputs=[self.log_std, self._noise], outputs=[self.log_probs]
        )

    def evaluate(self, obs: wp.array2d[wp.float32], mask: wp.array[wp.bool] | None = None) -> None:
        """Compute the values of the observations [N, O] of the worlds of `mask` [N], by default of all."""
        chosen = self._all_worlds if mask is None else mask
        self.normalizer.apply(obs, chosen, self._rows)
        self.critic.forward(self._rows, chosen)
