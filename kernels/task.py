"""A robot's task as tables of numbers, from the class table and the robot TOML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

__all__ = ["Task", "Term"]

Term = Mapping[str, Any]
"""An entry of the ``terms`` of a robot TOML."""


@dataclass(frozen=True, eq=False)
class Task:
    """The models, observation, reward and episodes of one robot.

    Attributes
    ----------
    models : tuple of mujoco.MjModel
        One compiled model per damage class, [D].
    codes : array of shape [D, K]
        Damage code of each class.
    disabled_touch : array of shape [D, L]
        Whether a class disables the touch sensor of a limb; no columns without touch sensors.
    limb_bodies : tuple of tuple of int
        Per limb, its bodies.
    touch_addresses : tuple of int
        Per limb, its entry of ``sensordata``; empty without touch sensors.
    main_body : int
        Body whose x position defines the forward velocity.
    frame_skip : int
        Physics steps of an env step.
    max_episode_steps : int
        Steps after which an episode is truncated.
    action_scale : float
        ctrl = `action_scale` · clip(action, ±1).
    qpos_noise, qvel_noise : float
        Half-width of the uniform noise on initial positions (m, rad), standard deviation of the normal noise
        on initial velocities (m/s, rad/s).
    height : tuple of float
        Lowest and highest z of the root, m.
    observation, reward : tuple of mapping
        Terms of the robot TOML.
    """

    models: tuple[mujoco.MjModel, ...]
    codes: NDArray[np.float32]
    disabled_touch: NDArray[np.bool_]
    limb_bodies: tuple[tuple[int, ...], ...]
    touch_addresses: tuple[int, ...]
    main_body: int
    frame_skip: int
    max_episode_steps: int
    action_scale: float
    qpos_noise: float
    qvel_noise: float
    height: tuple[float, float]
    observation: tuple[Term, ...]
    reward: tuple[Term, ...]

    @classmethod
    def of(cls, table: Any, reward: str | None = None) -> Task:  # noqa: ANN401 - kernels do not import its class
        """Return the task of a robot.

        Parameters
        ----------
        table : dappo_batch.ClassTable
            The compiled damage classes.
        reward : str, optional
            Name of a reward in the robot TOML; by default that of its entry ``reward.default``.
        """
        spec = table.robot.spec
        disabled = np.zeros((len(table.models), len(table.touch_addresses)), dtype=np.bool_)
        if table.touch_addresses:
            for row, limbs in zip(disabled, table.disabled_touch, strict=True):
                row[list(limbs)] = True
        # A task in the present form has sections of other names than one of an earlier version.
        low, high = spec.get("terminations", spec.get("termination"))["height"]
        observation = spec["observation"]
        if "rewards" in spec:
            terms = tuple({"term": name} | term for name, term in spec["rewards"].items())
        else:
            terms = tuple(spec["reward"][reward or spec["reward"]["default"]]["terms"])
        return cls(
            models=table.models,
            codes=np.array([item.code for item in table.space.classes], dtype=np.float32),
            disabled_touch=disabled,
            limb_bodies=table.limb_bodies,
            touch_addresses=table.touch_addresses,
            main_body=table.main_body,
            frame_skip=int(spec["frame_skip"]),
            max_episode_steps=int(spec["max_episode_steps"]),
            action_scale=float(spec["actions"]["scale"] if "actions" in spec else spec["action_scale"]),
            qpos_noise=float(spec["reset"]["qpos_noise"]),
            qvel_noise=float(spec["reset"]["qvel_noise"]),
            height=(float(low), float(high)),
            observation=tuple(observation.get("policy", observation)["terms"]),
            reward=terms,
        )

    @property
    def dt(self) -> float:
        """Duration of an env step, s."""
        return float(self.models[0].opt.timestep) * self.frame_skip

    def disabled_sites(self) -> list[frozenset[int]]:
        """Return per class the sites of the disabled touch sensors."""
        model = self.models[0]
        site_at = {
            int(address): int(site)
            for address, site in zip(model.sensor_adr, model.sensor_objid, strict=True)
        }
        sites = [site_at[address] for address in self.touch_addresses]
        return [frozenset(np.array(sites, dtype=int)[disabled].tolist()) for disabled in self.disabled_touch]
