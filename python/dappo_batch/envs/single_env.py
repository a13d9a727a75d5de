"""One damaged robot with Gymnasium's interface ``Env``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Unpack

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from dappo_batch._checks import boolean, integer
from dappo_batch.envs.arguments import ResetOptions, action_batch, state, stream_keys
from dappo_batch.envs.errors import ResetNeededError
from dappo_batch.envs.native import NativeEnv, SavedState
from dappo_batch.envs.options import EnvOptions, RobotLike, completed
from dappo_batch.envs.simulation import spaces

NO_TIME_LIMIT = 2**31 - 1


class DamageEnv(NativeEnv, gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """One robot, whose damage class is drawn for every episode.

    Parameters
    ----------
    robot : str, Path, Robot or ClassTable
        A name in `dappo_batch.ROBOTS`, the path of a robot TOML, or a loaded or compiled robot.
    **options
        See `EnvOptions`. Unlike in `DamageVectorEnv`, the default of `max_episode_steps` is no limit, because
        ``gymnasium.make`` adds the robot's limit with the wrapper ``TimeLimit``.

    Attributes
    ----------
    table : ClassTable
        One compiled model for each damage class.
    observation_space : gymnasium.spaces.Box
        Unbounded, float32 [O]: the robot's observation, then the damage code if it is observed.
    action_space : gymnasium.spaces.Box
        From -1 to 1, float32 [A].

    Raises
    ------
    ConfigError
        If an argument is out of range or a robot, class or reward does not exist.
    ShapeError
        If the number of weights in `damage` is not that of the classes.
    ClassTableError
        If a damage class of the robot does not compile.
    """

    _instead = (
        "create one with the same arguments in the process that uses it: vector envs of processes take "
        "functions that create envs"
    )

    def __init__(self, robot: RobotLike = "ant", **options: Unpack[EnvOptions]) -> None:
        chosen = completed(type(self).__name__, options, EnvOptions)
        chosen |= {"autoreset": AutoresetMode.DISABLED, "threads": 1}
        if chosen["max_episode_steps"] is None:
            chosen["max_episode_steps"] = NO_TIME_LIMIT
        self._start(robot, 1, chosen)
        self.observation_space, self.action_space = spaces(self._core)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin a new episode.

        Parameters
        ----------
        seed : int, optional
            Restarts the random stream; by default it continues.
        options : mapping, optional
            ``damage_class``: the class of this episode (id or spec string). ``onset``: the episode step
            at which the damage becomes active. ``damage_duration``, ``damage_pause``: steps for which it
            lasts (0: for good), and from its end until it returns (0: never).

        Returns
        -------
        obs : array of shape [O]
        info : dict
            As described at `step`.

        Raises
        ------
        ConfigError, ShapeError
            If the seed or an option does not fit.
        SimulationError
            If the env is closed.
        """
        self._check_open()
        chosen = ResetOptions.parse(options, self.table.space, 1)
        keys = None
        if seed is not None:
            seed = integer(seed, "seed", 0, 2**64 - 1)
            keys, _ = stream_keys(seed, 1)
        super().reset(seed=seed)
        self._core.reset(
            seeds=keys,
            classes=chosen.classes,
            onsets=chosen.onsets,
            durations=chosen.durations,
            pauses=chosen.pauses,
        )
        self._was_reset = True
        return self._obs(), self._info()

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Advance by one step.

        Parameters
        ----------
        action : array of shape [A]
            In [-1, 1]; other values are clipped, non-finite ones are errors.

        Returns
        -------
        obs : array of shape [O]
        reward : float
            Sum of the weighted terms of the chosen reward.
        terminated : bool
            The robot fell, or its physics diverged.
        truncated : bool
            The time limit was reached; never without `max_episode_steps`.
        info : dict
            ``damage_class`` (the active damage in this step, 0 before the onset and after the end),
            ``damage_onset`` (episode step), ``severity``, ``forward_velocity`` (m/s); with a task that has
            them, ``command`` [3] (m/s, m/s, rad/s) for the next step and ``events`` [E],
            what is random in this episode.

        Raises
        ------
        ShapeError
            If `action` has another shape.
        ConfigError
            If `action` contains non-finite values or is not numeric.
        ResetNeededError
            If the env was never reset.
        SimulationError
            If the env is closed.
        """
        self._check_open()
        core = self._core
        row = action_batch(action, (core.action_dim,))
        if not self._was_reset:
            raise ResetNeededError("call reset before the first step")
        core.step(row[np.newaxis])
        return (
            self._obs(),
            float(core.rewards[0]),
            bool(core.terminated[0]),
            bool(core.truncated[0]),
            self._info(),
        )

    def render(self) -> NDArray[np.uint8] | None:
        """Return a frame of the robot, uint8[480, 480, 3], or None without a render mode.

        The first frame starts a process with the first OpenGL implementation that works, with or without a
        display; ``MUJOCO_GL`` selects one. The camera follows the main body, and damaged limbs are red.

        Raises
        ------
        RenderError
            If no OpenGL implementation works; the message contains what to install.
        SimulationError
            If the env is closed.
        """
        pictures = self._pictures()
        return None if pictures is None else pictures[0]

    def get_state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the generalised positions [nq] (m, rad) and velocities [nv] (m/s, rad/s).

        Raises
        ------
        SimulationError
            If the env is closed.
        """
        self._check_open()
        qpos, qvel = self._core.get_state()
        return qpos[0], qvel[0]

    def set_state(
        self, qpos: NDArray[np.float64], qvel: NDArray[np.float64], *, at_rest: bool = False
    ) -> NDArray[np.float32]:
        """Set the state of the robot, keep its episode, and return the observation [O].

        If the state of the robot is more than positions and velocities, `at_rest` must be true, and the rest
        is as after a reset; see `DamageVectorEnv.set_state`.

        Parameters
        ----------
        qpos : array of shape [nq]
            In m and rad.
        qvel : array of shape [nv]
            In m/s and rad/s.
        at_rest : bool
            Whether the rest of the state, if there is any, may be as after a reset.

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
        positions, velocities = state(qpos, qvel, (model.nq,), (model.nv,))
        at_rest = boolean(at_rest, "at_rest")
        self._core.set_state(positions[np.newaxis], velocities[np.newaxis], at_rest)
        return self._obs()

    def restore_state(self, state: SavedState) -> NDArray[np.float32]:
        """Restore a saved state and return its observation [O]; see `DamageVectorEnv.restore_state`."""
        self._restore(state)
        return self._obs()

    def close(self) -> None:
        """Free the native memory and the renderer; repeated calls do nothing."""
        if not self.closed:
            self.closed = True
            self._free()

    def _obs(self) -> NDArray[np.float32]:
        obs: NDArray[np.float32] = self._core.obs[0].copy()
        return obs

    def _info(self) -> dict[str, Any]:
        return {
            "damage_class": int(self._core.damage_class[0]),
            "damage_onset": int(self._core.damage_onset[0]),
            "severity": float(self._severity()[0]),
            "forward_velocity": float(self._core.forward_velocity[0]),
            **{key: value[0].copy() for key, value in self._of_task().items()},
        }
