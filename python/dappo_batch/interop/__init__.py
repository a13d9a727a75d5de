"""Adaptors to programs that have a vector env of their own.

One module for each program, imported by name: the programs are not dependencies of this package, and
importing it imports none of them. Programs without a module here take Gymnasium's envs as they are.
"""

from __future__ import annotations

from gymnasium.vector import AutoresetMode

from dappo_batch._core import ConfigError
from dappo_batch.envs import DamageVectorEnv

__all__ = ["check_envs"]


def check_envs(envs: DamageVectorEnv, mode: AutoresetMode) -> None:
    """Check that `envs` begin episodes as an adaptor needs it, and return arrays that stay as they are.

    Raises
    ------
    ConfigError
        If the envs have another autoreset mode, or return views of memory that the next step overwrites.
    """
    if envs.autoreset_mode != mode:
        raise ConfigError(
            f"this adaptor needs envs with autoreset={mode.name.lower()!r}, "
            f"got {envs.autoreset_mode.name.lower()!r}"
        )
    if not envs.copy:
        raise ConfigError("this adaptor needs envs with copy=True, because its program keeps observations")
