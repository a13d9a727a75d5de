"""Rewards and terminations of env steps.

The terms are those of the robot TOML, as in ``rust/dappo-sim/src/terms/reward.rs``.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import mujoco_warp as mjw
import numpy as np
import warp as wp

from .task import Task, Term

__all__ = ["Outcome", "RewardTerms"]

wp.set_module_options({"enable_backward": False})

# Kinds of reward terms.
FORWARD_VELOCITY = wp.constant(0)
SURVIVE = wp.constant(1)
LIMB_CONTACTS = wp.constant(2)
CTRL_SQUARED = wp.constant(3)
CONTACT_FORCES_SQUARED = wp.constant(4)
LINK_LOADS_SQUARED = wp.constant(5)

_KINDS = {
    "forward_velocity": int(FORWARD_VELOCITY),
    "survive": int(SURVIVE),
    "limb_contacts": int(LIMB_CONTACTS),
    "ctrl_squared": int(CTRL_SQUARED),
    "contact_forces_squared": int(CONTACT_FORCES_SQUARED),
    "link_loads_squared": int(LINK_LOADS_SQUARED),
}

MAX_VALUE = wp.constant(1e10)  # mjMAXVAL: larger values are a divergence to MuJoCo


@wp.func
def out_of_bounds(values: wp.array2d[wp.float32], worldid: int) -> bool:
    """Return whether a row contains values with which the physics cannot continue (``mju_isBad``)."""
    for i in range(values.shape[1]):
        if not wp.abs(values[worldid, i]) <= MAX_VALUE:  # in this form, NaN is out of bounds
            return True
    return False


@wp.func
def clipped_square(force: wp.spatial_vector, clip: float) -> float:
    """Return the sum of a body's squared, clipped force components."""
    square = float(0.0)
    for i in range(6):
        component = wp.clamp(force[i], -clip, clip)
        square += component * component
    return square


@wp.func
def is_touched(
    bodies: wp.array[wp.int32], first: int, last: int, cfrc_ext: wp.array2d[wp.spatial_vector], worldid: int
) -> bool:
    """Return whether an external force acts on any of the bodies from `first` to `last`."""
    for i in range(first, last):
        force = cfrc_ext[worldid, bodies[i]]
        for j in range(6):
            if force[j] != 0.0:
                return True
    return False


@wp.func
def limbs_in_contact(
    limb_first: wp.array[wp.int32],
    limb_body: wp.array[wp.int32],
    cfrc_ext: wp.array2d[wp.spatial_vector],
    worldid: int,
) -> float:
    """Return the number of limbs in contact."""
    count = float(0.0)
    for limb in range(limb_first.shape[0] - 1):
        if is_touched(limb_body, limb_first[limb], limb_first[limb + 1], cfrc_ext, worldid):
            count += 1.0
    return count


@wp.kernel
def compute_outcome(
    # Model:
    kind_in: wp.array[wp.int32],
    weight_in: wp.array[wp.float32],
    clip_in: wp.array[wp.float32],
    limb_first_in: wp.array[wp.int32],
    limb_body_in: wp.array[wp.int32],
    main_body: int,
    dt: float,
    lowest: float,
    highest: float,
    # In:
    qpos_in: wp.array2d[wp.float32],
    qvel_in: wp.array2d[wp.float32],
    qacc_in: wp.array2d[wp.float32],
    ctrl_in: wp.array2d[wp.float32],
    cfrc_ext_in: wp.array2d[wp.spatial_vector],
    xpos_in: wp.array2d[wp.vec3],
    x_in: wp.array[wp.float32],
    # Out:
    x_out: wp.array[wp.float32],
    reward_out: wp.array[wp.float32],
    terminated_out: wp.array[wp.bool],
    diverged_out: wp.array[wp.bool],
    forward_velocity_out: wp.array[wp.float32],
) -> None:
    worldid = wp.tid()
    x_before = x_in[worldid]
    x_out[worldid] = xpos_in[worldid, main_body][0]
    diverged = (
        out_of_bounds(qpos_in, worldid) or out_of_bounds(qvel_in, worldid) or out_of_bounds(qacc_in, worldid)
    )
    diverged_out[worldid] = diverged
    if diverged:
        reward_out[worldid] = 0.0
        terminated_out[worldid] = True
        forward_velocity_out[worldid] = 0.0
        return

    velocity = (xpos_in[worldid, main_body][0] - x_before) / dt
    forward_velocity_out[worldid] = velocity
    height = qpos_in[worldid, 2]
    terminated = height < lowest or height > highest
    terminated_out[worldid] = terminated

    reward = float(0.0)
    for term in range(kind_in.shape[0]):
        kind = kind_in[term]
        value = float(0.0)
        if kind == FORWARD_VELOCITY:
            value = velocity
        elif kind == SURVIVE:
            value = wp.where(terminated, 0.0, 1.0)
        elif kind == LIMB_CONTACTS:
            value = limbs_in_contact(limb_first_in, limb_body_in, cfrc_ext_in, worldid)
        elif kind == CTRL_SQUARED:
            for i in range(ctrl_in.shape[1]):
                value += ctrl_in[worldid, i] * ctrl_in[worldid, i]
        elif kind == CONTACT_FORCES_SQUARED:
            for body in range(cfrc_ext_in.shape[1]):
                value += clipped_square(cfrc_ext_in[worldid, body], clip_in[term])
        elif kind == LINK_LOADS_SQUARED:
            for body in range(cfrc_ext_in.shape[1]):
                load = clipped_square(cfrc_ext_in[worldid, body], clip_in[term])
                value += load * load
        reward += weight_in[term] * value
    reward_out[worldid] = reward


@dataclass
class Outcome:
    """The outcome of an env step, one entry a world, before resets.

    Attributes
    ----------
    x : wp.array of shape [N]
        x position of the main body at the last physics evaluation, m: the start of the next displacement.
    reward : wp.array of shape [N]
        Weighted sum of the reward terms.
    terminated : wp.array of shape [N]
        Whether the robot has fallen or the physics has diverged.
    diverged : wp.array of shape [N]
        Whether the physics has diverged; reward and velocity are then 0.
    forward_velocity : wp.array of shape [N]
        Velocity of the main body along +x over the step, m/s.
    """

    x: wp.array[wp.float32]
    reward: wp.array[wp.float32]
    terminated: wp.array[wp.bool]
    diverged: wp.array[wp.bool]
    forward_velocity: wp.array[wp.float32]

    @classmethod
    def zeros(cls, num_worlds: int) -> Outcome:
        """Return zeros for `num_worlds` worlds."""
        floats = [wp.zeros(num_worlds, dtype=wp.float32) for _ in range(3)]
        flags = [wp.zeros(num_worlds, dtype=wp.bool) for _ in range(2)]
        return cls(floats[0], floats[1], flags[0], flags[1], floats[2])


class RewardTerms:
    """Reward terms and termination of one robot.

    Parameters
    ----------
    task : Task
        The robot.

    Raises
    ------
    ValueError
        If the kernels do not implement a reward term.
    """

    def __init__(self, task: Task) -> None:
        kinds = [_kind(term) for term in task.reward]
        firsts = [0, *itertools.accumulate(len(bodies) for bodies in task.limb_bodies)]
        bodies = [body for limb in task.limb_bodies for body in limb]
        self._model = [
            wp.array(np.array(kinds, dtype=np.int32), dtype=wp.int32),
            wp.array(np.array([term["weight"] for term in task.reward], dtype=np.float32), dtype=wp.float32),
            wp.array(np.array([term.get("clip", 0.0) for term in task.reward], np.float32), dtype=wp.float32),
            wp.array(firsts, dtype=wp.int32),
            wp.array(bodies, dtype=wp.int32),
            task.main_body,
            task.dt,
            *task.height,
        ]

    def compute(self, data: mjw.Data, outcome: Outcome) -> None:
        """Write the outcome of the step that ended in the state `data` into `outcome`."""
        wp.launch(
            compute_outcome,
            dim=data.nworld,
            inputs=[
                *self._model,
                data.qpos,
                data.qvel,
                data.qacc,
                data.ctrl,
                data.cfrc_ext,
                data.xpos,
                outcome.x,
            ],
            outputs=[
                outcome.x,
                outcome.reward,
                outcome.terminated,
                outcome.diverged,
                outcome.forward_velocity,
            ],
        )


def _kind(term: Term) -> int:
    if term["term"] not in _KINDS:
        raise ValueError(f"the kernels do not implement the reward term {term['term']!r}")
    return _KINDS[term["term"]]
