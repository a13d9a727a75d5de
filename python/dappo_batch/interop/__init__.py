"""Adaptors to libraries with their own vector env interface.

There is one module for each library, which is imported explicitly: the libraries are not dependencies of this
package. Libraries without a module here use Gymnasium's envs directly.
"""

from __future__ import annotations

from gymnasium.vector import AutoresetMode

from dappo_batch._core import ConfigError
from dappo_batch.envs import DamageVectorEnv

__all__ = ["check_envs"]


def check_envs(envs: DamageVectorEnv, mode: AutoresetMode) -> None:
    """Check that `envs` have the autoreset mode of an adaptor and return copies.

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
        raise ConfigError("this adaptor needs envs with copy=True, because the library keeps observations")
