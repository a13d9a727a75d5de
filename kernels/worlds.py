"""The vector env on the device: N damage-randomised worlds that step, end and begin anew without the host.

All worlds do everything in the same order, under masks, so that a step is one fixed sequence of launches and
can be captured in a graph. What may change between launches lies in arrays.
"""

from __future__ import annotations

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from .damage import DamageFields, class_rows
from .episode import BEFORE_THE_FIRST, Endings, Episodes, count_step, keep_final, strike
from .observe import Observer
from .outcome import Judge, Outcome
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
    """N worlds of one robot, each with an episode and a damage class of its own, in same-step mode.

    Everything is allocated here and on Warp's current device; `step` and `reset` allocate nothing that lasts.

    Parameters
    ----------
    task : Task
        The robot.
    keys : array of shape [N]
        Random key of each world.
    observe_damage : bool
        Append the damage code of the class in force to every observation.
    max_episode_steps : int, optional
        Steps after which an episode is truncated; the robot's own limit if left out.
    nconmax, njmax : int, optional
        Room for contacts, a world on average, and for constraints, in any one world. By default what a limbed
        robot on a plane can need at most.

    Attributes
    ----------
    model, data : mjw.Model, mjw.Data
        The physics.
    episodes : Episodes
        Where every world stands.
    draws : EpisodeDraws
        Distributions of damage classes and onsets; assign to its arrays to change them.
    outcome : Outcome
        Rewards and failures of the last step.
    endings : Endings
        Ends of episodes in the last step, and what the resets have overwritten.
    obs : wp.array of shape [N, O]
        Observations after the last step; where an episode ended, the first of the next one.
    diverged, nonfinite_actions : wp.array of shape [1]
        How often the physics of a world diverged, and how many numbers in actions were not finite.
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
        self.model.opt.warn_overflow = 0  # the host reads the flags and says what to do
        self.data = mjw.make_data(
            healthy, nworld=self.num_worlds, nconmax=nconmax or room[0], njmax=njmax or room[1]
        )
        rows = class_rows(self.model, task.models, task.muted_sites())
        self.episodes = Episodes.before_the_first(keys)
        self.draws = EpisodeDraws(self.num_worlds, len(task.models))
        self.outcome = Outcome.zeros(self.num_worlds)
        self._fields = DamageFields(self.model, rows, self.num_worlds)
        self._observer = Observer(task, observe_damage)
        self._judge = Judge(task)
        self._reset = StateReset(task, self._observer.needs_forces)
        self._everyone = wp.full(self.num_worlds, True, dtype=wp.bool)
        self._struck = wp.zeros(self.num_worlds, dtype=wp.bool)
        self.endings = Endings.zeros(
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
        """Advance every world by one env step; where an episode ends, the next one begins at once.

        Parameters
        ----------
        actions : wp.array of shape [N, A]
            Clipped to ±1.
        """
        episodes = self.episodes
        strike(episodes, self._struck)
        self._fields.gather(self._struck, episodes.damage_class)
        self.advance(actions)
        count_step(episodes, self.outcome, self.endings)
        keep_final(episodes, self.obs, self.endings)
        self._begin(self.endings.ended)

    def advance(self, actions: wp.array2d[wp.float32]) -> None:
        """Do the physics of an env step alone, judge and observe it: no onset, no end of an episode.

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
        self._judge.judge(data, self.outcome)
        wp.launch(count_divergences, self.num_worlds, inputs=[self.outcome.diverged], outputs=[self.diverged])
        self._reset.rest(model, data, self.outcome.diverged, classes)
        self._observer.observe(data, self._everyone, classes, self.obs)

    def reset(
        self,
        *,
        mask: ArrayLike | None = None,
        keys: ArrayLike | None = None,
        classes: ArrayLike | None = None,
        onsets: ArrayLike | None = None,
    ) -> None:
        """Begin new episodes on behalf of the host.

        Parameters
        ----------
        mask : array of shape [N], optional
            Worlds to reset; all by default.
        keys : array of shape [N], optional
            New random keys for all worlds; episodes count from 0 again.
        classes, onsets : array of shape [N], optional
            Damage classes and onsets, `DRAW` where the world draws its own.
        """
        if keys is not None:
            self.episodes.key.assign(np.asarray(keys, dtype=np.uint64))
            self.forget_episodes()
        chosen = self._everyone if mask is None else wp.array(np.asarray(mask), dtype=wp.bool)
        self._begin(chosen, self._fixed(classes), self._fixed(onsets))

    def forget_episodes(self) -> None:
        """Let the next reset begin every world's episode 0, as if nothing had happened before."""
        self.episodes.number.fill_(wp.uint64(BEFORE_THE_FIRST))
        for counter in (self.diverged, self.nonfinite_actions, self.data.overflow):
            counter.zero_()

    def set_state(self, qpos: ArrayLike, qvel: ArrayLike, mask: NDArray[np.bool_] | None = None) -> None:
        """Put worlds into states [N, nq] and [N, nv], at rest from forces; their episodes go on.

        Parameters
        ----------
        qpos, qvel : array of shape [N, nq] and [N, nv]
            Positions and velocities.
        mask : array of shape [N], optional
            Worlds that are put there; all by default.
        """
        chosen = self._everyone if mask is None else wp.array(mask, dtype=wp.bool)
        self._reset.rest(self.model, self.data, chosen, self.episodes.damage_class)
        rows = np.ones(self.num_worlds, dtype=np.bool_) if mask is None else mask
        for array, values in ((self.data.qpos, qpos), (self.data.qvel, qvel)):
            array.assign(np.where(rows[:, None], np.asarray(values, dtype=np.float32), array.numpy()))
        self._reset.settle(self.model, self.data, chosen, self.outcome)
        self._observer.observe(self.data, chosen, self.episodes.damage_class, self.obs)

    def read_state(self) -> NDArray[np.float32]:
        """Return what the physics goes on from, one row a world: time, x, qpos, qvel, act, warm start."""
        return np.concatenate([_rows(array) for array in self._state()], axis=1)

    def write_state(self, rows: NDArray[np.float32], mask: NDArray[np.bool_] | None = None) -> None:
        """Go back to rows that `read_state` has returned, in the worlds of `mask` [N] or in all.

        Their damage classes must be those of that time.
        """
        chosen = np.ones(self.num_worlds, dtype=np.bool_) if mask is None else mask
        start = 0
        for array in self._state():
            old = _rows(array)
            new = rows[:, start : start + old.shape[1]]
            start += old.shape[1]
            array.assign(np.where(chosen[:, None], new, old).reshape(array.shape))

    def put_on_classes(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Give worlds, those of `mask` [N] or all, the model of their damage class in force."""
        chosen = self._everyone if mask is None else wp.array(mask, dtype=wp.bool)
        self._fields.gather(chosen, self.episodes.damage_class)

    def check_room(self) -> None:
        """Raise if contacts or constraints were left out since the last call.

        Raises
        ------
        PhysicsOverflowError
            If there were more than there is room for.
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
        self.enter(mask)

    def enter(self, mask: wp.array[wp.bool]) -> None:
        """Put the selected worlds into the model and the initial state of their episodes."""
        self._fields.gather(mask, self.episodes.damage_class)
        self._reset.begin(self.model, self.data, mask, self.episodes, self.outcome)
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
    """Return the most contacts and constraints that a robot can have whose contacts are pairs with a plane.

    Returns
    -------
    tuple of int or None
        `nconmax` and `njmax`; None, which leaves the guess to mujoco_warp, for every other robot.
    """
    # mujoco_warp takes all corners of a box that has sunk in, MuJoCo four of them.
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
