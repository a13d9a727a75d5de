"""Many damaged robots with Gymnasium's interface ``VectorEnv``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Unpack

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from dappo_batch._checks import boolean, integer
from dappo_batch.envs.arguments import (
    MOST_ENVS,
    ResetOptions,
    Seed,
    action_batch,
    autoreset_mode,
    state,
    stream_keys,
)
from dappo_batch.envs.errors import ResetNeededError
from dappo_batch.envs.native import NativeEnv, SavedState
from dappo_batch.envs.options import RobotLike, VectorEnvOptions, completed
from dappo_batch.envs.simulation import spaces

Infos = dict[str, Any]


class DamageVectorEnv(NativeEnv, VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """N independent episodes of one robot, each with its own damage class.

    The envs are in native memory and are stepped by a pool of threads. Results do not depend on the number of
    threads, and env ``i`` is bit-identical to a `DamageEnv` that was reset with seed ``seed + i``. A forked
    process continues with its own copy and threads. It cannot be pickled.

    Parameters
    ----------
    robot : str, Path, Robot or ClassTable
        A name in `dappo_batch.ROBOTS`, the path of a robot TOML, or a loaded or compiled robot.
    num_envs : int
        Number of environments N.
    **options
        See `VectorEnvOptions`.

    Attributes
    ----------
    table : ClassTable
        One compiled model for each damage class.
    single_observation_space : gymnasium.spaces.Box
        Unbounded, float32 [O]: the robot's observation, then the damage code if it is observed.
    single_action_space : gymnasium.spaces.Box
        From -1 to 1, float32 [A].
    observation_space, action_space : gymnasium.spaces.Box
        The same for all envs, [N, O] and [N, A].
    observe_damage : bool
        Whether observations end with the damage code.
    max_episode_steps : int
        Steps after which an episode is truncated.

    Raises
    ------
    ConfigError
        If an argument is out of range or a robot, class or reward does not exist.
    ShapeError
        If the number of seeds is not N, or that of the weights in `damage` not D.
    ClassTableError
        If a damage class of the robot does not compile.
    """

    _instead = (
        "create one with the same arguments in the process that uses it, and copy the states with get_state "
        "and set_state"
    )

    def __init__(
        self, robot: RobotLike = "ant", num_envs: int = 1, **options: Unpack[VectorEnvOptions]
    ) -> None:
        chosen = completed(type(self).__name__, options, VectorEnvOptions)
        self.num_envs = integer(num_envs, "num_envs", 1, MOST_ENVS)
        self.autoreset_mode = autoreset_mode(chosen["autoreset"])
        self.copy = boolean(chosen["copy"], "copy")
        self._start(robot, self.num_envs, chosen)
        self.observe_damage = boolean(chosen["observe_damage"], "observe_damage")
        limit = chosen["max_episode_steps"]
        self.max_episode_steps = int(self.table.robot.spec["max_episode_steps"] if limit is None else limit)
        self.metadata["autoreset_mode"] = self.autoreset_mode
        self.single_observation_space, self.single_action_space = spaces(self._core)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._action_shape = (self.num_envs, self._core.action_dim)
        self._all_envs = np.ones(self.num_envs, dtype=np.bool_)
        self._all_envs.flags.writeable = False  # returned as an info mask when copy=False

    @property
    def num_threads(self) -> int:
        """Number of worker threads."""
        return self._core.num_threads

    @property
    def backend(self) -> str:
        """Name of the simulation backend, ``"lanes"``, ``"mujoco"`` or ``"warp"``."""
        return self._core.backend

    @property
    def device(self) -> str:
        """Device of the physics, ``"cpu"``, ``"gpu"``, ``"cuda"`` or ``"warp-cpu"``."""
        return self._core.device

    @property
    def backend_note(self) -> str:
        """Why ``"auto"`` is not ``"lanes"``, or in what ``"lanes"`` differs from the options of the MJCF.

        It is empty if there is nothing of both, or if the backend ``"mujoco"`` was chosen.
        """
        return self._core.backend_note

    @property
    def reward_terms(self) -> NDArray[np.float64]:
        """Terms of the rewards of the last step, their weights included, [N, K].

        Their sum over K is the reward, but for envs that were reset in that step or whose physics diverged.
        The device kernels of the backend ``"warp"`` do not report them: they are 0.
        """
        return self._give(self._core.reward_terms)

    @property
    def precision(self) -> str:
        """Floating-point format of the simulation, ``"f32"`` or ``"f64"``."""
        return self._core.precision

    @property
    def diverged(self) -> int:
        """Number of divergences of the physics of an env since this object was created.

        A state has diverged if a number is not finite, or if a position, velocity or acceleration is larger
        than 1e10, MuJoCo's limit. The step is ``terminated`` with reward and forward velocity 0, and its
        observation is that of the robot at rest in the reference pose of its damage class.
        """
        return self._core.diverged

    def reset(
        self, *, seed: Seed = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Infos]:
        """Begin a new episode in every env, or in those selected by ``options["reset_mask"]``.

        Parameters
        ----------
        seed : int or sequence of int or None, optional
            An integer restarts the random stream of env ``i`` with ``seed + i``; a sequence has one
            seed for each env, and ``None`` keeps the stream of that env. By default all streams continue.
        options : mapping, optional
            ``reset_mask``: booleans [N]. ``damage_class``: one class (id or spec string) or one per env.
            ``onset``: the episode step at which the damage becomes active, one or one per env.
            ``damage_duration``, ``damage_pause``: steps for which it lasts (0: for good), and from its end
            until it returns (0: never), one or one per env. With one value per env, those that are ``None``
            or -1 are drawn by the env.

        Returns
        -------
        obs : array of shape [N, O]
            Observations; rows of envs that were not reset are unchanged.
        infos : dict
            As described at `step`, for the envs that were reset.

        Raises
        ------
        ConfigError, ShapeError
            If a seed or an option does not fit.
        ResetNeededError
            If the very first reset selects only some envs.
        SimulationError
            If the env is closed.
        """
        self._check_open()
        chosen = ResetOptions.parse(options, self.table.space, self.num_envs)
        mask = self._all_envs if chosen.mask is None else chosen.mask
        if not self._was_reset and not mask.all():
            raise ResetNeededError("options['reset_mask'] must select every env in the first reset")
        keys, given = None, np.zeros_like(mask)
        if seed is not None:
            keys, given = stream_keys(seed, self.num_envs)
        # Envs with a new seed restart their stream, the others begin the next episode of theirs.
        for part, part_keys in ((mask & given, keys), (mask & ~given, None)):
            if part.any():
                self._core.reset(
                    seeds=part_keys,
                    mask=None if part.all() else part,
                    classes=chosen.classes,
                    onsets=chosen.onsets,
                    durations=chosen.durations,
                    pauses=chosen.pauses,
                )
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))  # seeds Gymnasium's np_random
        self._was_reset = True
        self._ended &= ~mask
        return self._give(self._core.obs), self._infos(mask)

    def step(
        self, actions: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Advance every env by one step.

        Parameters
        ----------
        actions : array of shape [N, A]
            In [-1, 1]; other values are clipped, non-finite ones are errors.

        Returns
        -------
        obs : array of shape [N, O]
            Observations; in mode ``same_step``, where an episode ended, the first one of the next episode.
        rewards : array of shape [N]
        terminated : array of shape [N]
            The robot fell, or its physics diverged (see `diverged`).
        truncated : array of shape [N]
            The time limit was reached.
        infos : dict
            ``damage_class`` (the active damage in this step, 0 before the onset and after the end),
            ``damage_onset`` (episode step), ``severity``, ``forward_velocity`` (m/s, 0 where an episode
            begins), each of shape [N] with its mask ``_key``. With a task that has them, ``command`` [N, 3]
            (m/s, m/s, rad/s) for the next step and ``events`` [N, E], what is random in each episode. In mode
            ``same_step``, where an episode ended: ``final_obs`` (objects, arrays of shape [O]) and
            ``final_info`` (the keys of the damage and the velocity at the episode's last step).

        Raises
        ------
        ShapeError
            If `actions` has another shape.
        ConfigError
            If `actions` contains non-finite values or is not numeric.
        ResetNeededError
            If the env was never reset, or in mode ``disabled`` an ended episode was not reset.
        SimulationError
            If the env is closed.
        """
        self._check_open()
        batch = action_batch(actions, self._action_shape)
        if not self._was_reset:
            raise ResetNeededError("call reset before the first step")
        if self._ended.any():
            waiting = np.flatnonzero(self._ended)
            raise ResetNeededError(
                f"{waiting.size} envs have ended, the first is env {waiting[0]}: with autoreset='disabled' "
                "reset them with options={'reset_mask': ...} before the next step"
            )
        core, severity = self._core, self._severity()
        core.step(batch)
        infos = self._infos(self._all_envs)
        if self.autoreset_mode == AutoresetMode.DISABLED:
            np.logical_or(core.terminated, core.truncated, out=self._ended)
        elif self.autoreset_mode == AutoresetMode.SAME_STEP:
            infos |= self._final_infos(severity)
        return (
            self._give(core.obs),
            self._give(core.rewards),
            self._give(core.terminated),
            self._give(core.truncated),
            infos,
        )

    def get_state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the generalised positions and velocities of all envs.

        Returns
        -------
        qpos : array of shape [N, nq]
            In m and rad, quaternions of free joints as (w, x, y, z).
        qvel : array of shape [N, nv]
            In m/s and rad/s.

        Raises
        ------
        SimulationError
            If the env is closed.
        """
        self._check_open()
        return self._core.get_state()

    def set_state(
        self, qpos: NDArray[np.float64], qvel: NDArray[np.float64], *, at_rest: bool = False
    ) -> NDArray[np.float32]:
        """Set the state of every env and keep its episode.

        Contact forces are cleared as in a reset; the damage class and the step of the episode are kept. With
        `precision` ``"f32"`` the state is rounded.

        Some robots have more state than positions and velocities: filtered actuators, delayed signals,
        plugins, and the warm start of a solver with few iterations. For these robots `at_rest` must be true,
        and the rest of the state is as after a reset. `save_state` and `restore_state` keep the complete
        state.

        Parameters
        ----------
        qpos : array of shape [N, nq]
            In m and rad.
        qvel : array of shape [N, nv]
            In m/s and rad/s.
        at_rest : bool
            Whether the rest of the state, if there is any, may be as after a reset.

        Returns
        -------
        obs : array of shape [N, O]

        Raises
        ------
        ShapeError
            If an array has another shape.
        ConfigError
            If the env was never reset, an array contains anything but finite numbers, or the state of the
            robot is more than positions and velocities and `at_rest` is false.
        SimulationError
            If the env is closed.
        """
        self._check_open()
        model = self.table.models[0]
        positions, velocities = state(qpos, qvel, (self.num_envs, model.nq), (self.num_envs, model.nv))
        self._core.set_state(positions, velocities, boolean(at_rest, "at_rest"))
        return self._give(self._core.obs)

    def restore_state(self, state: SavedState) -> NDArray[np.float32]:
        """Restore a state that was saved by an env of the same robot, backend, precision and number of envs.

        Returns
        -------
        obs : array of shape [N, O]
            Observations of the saved state.

        Raises
        ------
        ConfigError
            If `state` is not a saved state, or was saved before the first reset.
        CheckpointError
            If it does not fit this env.
        SimulationError
            If the env is closed.
        """
        self._restore(state)
        return self._give(self._core.obs)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a frame of every env, a tuple of N uint8[480, 480, 3], or None without a render mode.

        As in `DamageEnv.render`, a separate process draws, one env after the other: this is for few envs.

        Raises
        ------
        RenderError
            If no OpenGL implementation works; the message contains what to install.
        SimulationError
            If the env is closed.
        """
        return self._pictures()

    def close_extras(self) -> None:
        """Free the native memory; called by `close`."""
        self._free()

    def _give(self, array: NDArray[Any]) -> NDArray[Any]:
        return array.copy() if self.copy else array

    def _infos(self, mask: NDArray[np.bool_]) -> Infos:
        """Return the info arrays with zeros outside `mask`, as Gymnasium's vector envs do."""
        values = {
            "damage_class": self._core.damage_class,
            "damage_onset": self._core.damage_onset,
            "severity": self._severity(),
            "forward_velocity": self._core.forward_velocity,
            **self._of_task(),
        }
        return self._masked(values, mask)

    def _masked(self, values: Mapping[str, NDArray[Any]], mask: NDArray[np.bool_]) -> Infos:
        everywhere = bool(mask.all())
        infos: Infos = {}
        for key, value in values.items():
            shown = mask if value.ndim == 1 else mask[:, None]
            infos[key] = self._give(value) if everywhere else np.where(shown, value, value.dtype.type(0))
            infos[f"_{key}"] = self._give(mask)
        return infos

    def _final_infos(self, severity: NDArray[np.float64]) -> Infos:
        """Return ``final_obs`` and ``final_info`` of the episodes that ended in this step, if any did.

        `severity` is that of the episodes before the step, [N].
        """
        core = self._core
        mask = core.final_mask.copy()
        if not mask.any():
            return {}
        last = core.final_obs
        final_obs = np.full(self.num_envs, None, dtype=object)
        for index in np.flatnonzero(mask):
            final_obs[index] = last[index].copy()
        values = {
            "damage_class": core.final_damage_class,
            "damage_onset": core.final_damage_onset,
            "severity": severity,
            "forward_velocity": core.final_forward_velocity,
        }
        return {
            "final_obs": final_obs,
            "_final_obs": mask,
            "final_info": self._masked(values, mask),
            "_final_info": mask.copy(),
        }
