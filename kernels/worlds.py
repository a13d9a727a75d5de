"""The vector env on the device: N damage-randomised worlds that are stepped and reset without the host.

Every world runs the same kernels in the same order, under masks: a step is one fixed sequence of launches
that a graph can capture. Values that change between launches are in arrays.
"""

from __future__ import annotations

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from .damage import DamageFields, class_rows
from .episode import NOT_STARTED, EpisodeEnds, Episodes, activate_damage, count_step, save_final
from .observe import Observer
from .outcome import Outcome, RewardTerms
from .overflow import check_overflow
from .reset import DRAW, EpisodeDraws, StateReset
from .task import Task

__all__ = ["Worlds"]

wp.set_module_options({"enable_backward": False})


@wp.kernel
def apply_actions(
    # Model:
    action_scale: float,
    # In:
    actions_in: wp.array2d[wp.float32],
    # Out:
    ctrl_out: wp.array2d[wp.float32],
    nonfinite_out: wp.array[wp.int32],
) -> None:
    worldid, i = wp.tid()
    action = actions_in[worldid, i]
    if not wp.isfinite(action):
        wp.atomic_add(nonfinite_out, 0, 1)
        action = wp.float32(0.0)
    ctrl_out[worldid, i] = action_scale * wp.clamp(action, -1.0, 1.0)


@wp.kernel
def count_divergences(
    # In:
    diverged_in: wp.array[wp.bool],
    # Out:
    count_out: wp.array[wp.int32],
) -> None:
    worldid = wp.tid()
    if diverged_in[worldid]:
        wp.atomic_add(count_out, 0, 1)


class Worlds:
    """N worlds of one robot, each with its own episode and damage class, in autoreset mode ``same_step``.

    All arrays are allocated here, on Warp's current device; `step` and `reset` allocate only temporary ones.

    Parameters
    ----------
    task : Task
        The robot.
    keys : array of shape [N]
        Random key of each world.
    observe_damage : bool
        Append the damage code of the active damage class to every observation.
    max_episode_steps : int, optional
        Steps after which an episode is truncated; by default the limit of the robot TOML.
    nconmax, njmax : int, optional
        Buffer sizes: contacts, as an average over the worlds, and constraints of each world. By default the
        most that a limbed robot on a plane can need.

    Attributes
    ----------
    model, data : mjw.Model, mjw.Data
        The physics.
    episodes : Episodes
        The running episode of every world.
    draws : EpisodeDraws
        Distributions of damage classes and onsets; assign to its arrays to change them.
    outcome : Outcome
        Rewards and terminations of the last step.
    episode_ends : EpisodeEnds
        Episodes that ended in the last step, with the values that their resets have overwritten.
    obs : wp.array of shape [N, O]
        Observations after the last step; where an episode ended, the first one of the next episode.
    diverged, nonfinite_actions : wp.array of shape [1]
        Number of divergences of the physics of a world, and of entries of actions that were not finite.
    """

    def __init__(
        self,
        task: Task,
        keys: NDArray[np.uint64],
        *,
        observe_damage: bool = True,
        max_episode_steps: int | None = None,
        nconmax: int | None = None,
        njmax: int | None = None,
    ) -> None:
        self.task = task
        self.num_worlds = len(keys)
        healthy = task.models[0]
        room = contact_bound(healthy)
        self.model = mjw.put_model(healthy)
        self.model.opt.warn_overflow = 0  # the host reads the flags and raises
        self.data = mjw.make_data(
            healthy, nworld=self.num_worlds, nconmax=nconmax or room[0], njmax=njmax or room[1]
        )
        rows = class_rows(self.model, task.models, task.disabled_sites())
        self.episodes = Episodes.unstarted(keys)
        self.draws = EpisodeDraws(self.num_worlds, len(task.models))
        self.outcome = Outcome.zeros(self.num_worlds)
        self._fields = DamageFields(self.model, rows, self.num_worlds)
        self._observer = Observer(task, observe_damage)
        self._reward_terms = RewardTerms(task)
        self._reset = StateReset(task, self._observer.needs_forces)
        self._all_worlds = wp.full(self.num_worlds, True, dtype=wp.bool)
        self._activated = wp.zeros(self.num_worlds, dtype=wp.bool)
        self.episode_ends = EpisodeEnds.zeros(
            self.num_worlds, self.obs_dim, max_episode_steps or task.max_episode_steps
        )
        self.obs = wp.zeros((self.num_worlds, self.obs_dim), dtype=wp.float32)
        self.diverged = wp.zeros(1, dtype=wp.int32)
        self.nonfinite_actions = wp.zeros(1, dtype=wp.int32)

    @property
    def obs_dim(self) -> int:
        """Length of an observation, the damage code included."""
        return self._observer.obs_dim

    @property
    def code_length(self) -> int:
        """Length of the damage code in an observation; 0 where damage is not observed."""
        return self._observer.code_length

    @property
    def action_dim(self) -> int:
        """Length of an action."""
        return int(self.task.models[0].nu)

    @property
    def row_length(self) -> int:
        """Length of the rows of `read_state`."""
        return sum(int(np.prod(array.shape[1:])) for array in self._state())

    def step(self, actions: wp.array2d[wp.float32]) -> None:
        """Advance every world by one env step and reset the worlds whose episodes end.

        Parameters
        ----------
        actions : wp.array of shape [N, A]
            Clipped to ±1.
        """
        episodes = self.episodes
        activate_damage(episodes, self._activated)
        self._fields.gather(self._activated, episodes.damage_class)
        self.advance(actions)
        count_step(episodes, self.outcome, self.episode_ends)
        save_final(episodes, self.obs, self.episode_ends)
        self._begin(self.episode_ends.ended)

    def advance(self, actions: wp.array2d[wp.float32]) -> None:
        """Compute physics, outcome and observations of an env step, without onsets and ends of episodes.

        Parameters
        ----------
        actions : wp.array of shape [N, A]
            Clipped to ±1.
        """
        model, data, classes = self.model, self.data, self.episodes.damage_class
        wp.launch(
            apply_actions,
            dim=actions.shape,
            inputs=[self.task.action_scale, actions],
            outputs=[data.ctrl, self.nonfinite_actions],
        )
        for _ in range(self.task.frame_skip):
            mjw.step(model, data)
        mjw.rne_postconstraint(model, data)
        self._reward_terms.compute(data, self.outcome)
        wp.launch(count_divergences, self.num_worlds, inputs=[self.outcome.diverged], outputs=[self.diverged])
        self._reset.to_reference(model, data, self.outcome.diverged, classes)
        self._observer.observe(data, self._all_worlds, classes, self.obs)

    def reset(
        self,
        *,
        mask: ArrayLike | None = None,
        keys: ArrayLike | None = None,
        classes: ArrayLike | None = None,
        onsets: ArrayLike | None = None,
    ) -> None:
        """Begin new episodes, on request of the host.

        Parameters
        ----------
        mask : array of shape [N], optional
            Worlds to reset; all by default.
        keys : array of shape [N], optional
            New random keys for all worlds; their episodes are numbered from 0 again.
        classes, onsets : array of shape [N], optional
            Damage classes and onsets, `DRAW` where the world draws its own.
        """
        if keys is not None:
            self.episodes.key.assign(np.asarray(keys, dtype=np.uint64))
            self.restart_numbering()
        chosen = self._all_worlds if mask is None else wp.array(np.asarray(mask), dtype=wp.bool)
        self._begin(chosen, self._fixed(classes), self._fixed(onsets))

    def restart_numbering(self) -> None:
        """Clear all counters: the next reset begins episode 0 of every world."""
        self.episodes.number.fill_(wp.uint64(NOT_STARTED))
        for counter in (self.diverged, self.nonfinite_actions, self.data.overflow):
            counter.zero_()

    def set_state(self, qpos: ArrayLike, qvel: ArrayLike, mask: NDArray[np.bool_] | None = None) -> None:
        """Set the states of worlds, with forces and activations zero; their episodes continue.

        Parameters
        ----------
        qpos, qvel : array of shape [N, nq] and [N, nv]
            Positions (m, rad) and velocities (m/s, rad/s).
        mask : array of shape [N], optional
            Worlds to set; all by default.
        """
        chosen = self._all_worlds if mask is None else wp.array(mask, dtype=wp.bool)
        self._reset.to_reference(self.model, self.data, chosen, self.episodes.damage_class)
        rows = np.ones(self.num_worlds, dtype=np.bool_) if mask is None else mask
        for array, values in ((self.data.qpos, qpos), (self.data.qvel, qvel)):
            array.assign(np.where(rows[:, None], np.asarray(values, dtype=np.float32), array.numpy()))
        self._reset.evaluate(self.model, self.data, chosen, self.outcome)
        self._observer.observe(self.data, chosen, self.episodes.damage_class, self.obs)

    def read_state(self) -> NDArray[np.float32]:
        """Return the state of the physics, one row a world: time, x, qpos, qvel, act, warm start."""
        return np.concatenate([_rows(array) for array in self._state()], axis=1)

    def write_state(self, rows: NDArray[np.float32], mask: NDArray[np.bool_] | None = None) -> None:
        """Restore rows that `read_state` returned, in the worlds of `mask` [N] or in all.

        The active damage classes must be the same as at the time of `read_state`.
        """
        chosen = np.ones(self.num_worlds, dtype=np.bool_) if mask is None else mask
        start = 0
        for array in self._state():
            old = _rows(array)
            new = rows[:, start : start + old.shape[1]]
            start += old.shape[1]
            array.assign(np.where(chosen[:, None], new, old).reshape(array.shape))

    def apply_classes(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Copy the model of the active damage class into the worlds of `mask` [N], or into all."""
        chosen = self._all_worlds if mask is None else wp.array(mask, dtype=wp.bool)
        self._fields.gather(chosen, self.episodes.damage_class)

    def raise_on_overflow(self) -> None:
        """Raise if a buffer was too small for all contacts or constraints since the last call.

        Raises
        ------
        PhysicsOverflowError
            With the sizes to raise.
        """
        flags = self.data.overflow.numpy().copy()  # on a CPU it is a view
        if flags.any():
            self.data.overflow.zero_()
            check_overflow(flags, self.data.njmax, self.data.naconmax // self.num_worlds)

    def _begin(
        self,
        mask: wp.array[wp.bool],
        classes: wp.array[wp.int32] | None = None,
        onsets: wp.array[wp.int32] | None = None,
    ) -> None:
        self.draws.begin(self.episodes, mask, classes, onsets)
        self.reset_states(mask)

    def reset_states(self, mask: wp.array[wp.bool]) -> None:
        """Set the models and the initial states of the episodes of the selected worlds."""
        self._fields.gather(mask, self.episodes.damage_class)
        self._reset.to_initial(self.model, self.data, mask, self.episodes, self.outcome)
        self._observer.observe(self.data, mask, self.episodes.damage_class, self.obs)

    def _state(self) -> tuple[wp.array[wp.float32], ...]:
        data = self.data
        return data.time, self.outcome.x, data.qpos, data.qvel, data.act, data.qacc_warmstart

    def _fixed(self, values: ArrayLike | None) -> wp.array[wp.int32] | None:
        if values is None:
            return None
        spread = np.broadcast_to(np.asarray(values, dtype=np.int32), self.num_worlds)
        return wp.array(np.where(spread < 0, DRAW, spread), dtype=wp.int32)


def _rows(array: wp.array[wp.float32]) -> NDArray[np.float32]:
    """Return a field as rows, one a world."""
    return array.numpy().reshape(array.shape[0], -1)


def contact_bound(model: mujoco.MjModel) -> tuple[int | None, int | None]:
    """Return the most contacts and constraints of a robot whose contact pairs all include a plane.

    Returns
    -------
    tuple of int or None
        `nconmax` and `njmax`; for other robots None, for which mujoco_warp chooses sizes itself.
    """
    # mujoco_warp generates a contact for every penetrating corner of a box, MuJoCo for four of them.
    most = {mujoco.mjtGeom.mjGEOM_SPHERE: 1, mujoco.mjtGeom.mjGEOM_CAPSULE: 2, mujoco.mjtGeom.mjGEOM_BOX: 8}
    contacts = 0
    for pair in zip(model.pair_geom1, model.pair_geom2, strict=True):
        kinds = sorted(int(model.geom_type[geom]) for geom in pair)
        if kinds[0] != mujoco.mjtGeom.mjGEOM_PLANE or kinds[1] not in most:
            return None, None
        contacts += most[kinds[1]]
    if not contacts or np.any(model.geom_contype) or model.neq or model.ntendon:
        return None, None
    dim = int(model.pair_dim.max())
    rows = dim if model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC else max(1, 2 * (dim - 1))
    limits = int(np.sum(model.jnt_limited)) + int(np.sum(model.dof_frictionloss > 0))
    return contacts, contacts * rows + limits
