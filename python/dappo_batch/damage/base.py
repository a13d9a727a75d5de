"""Base class of damage types."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    import mujoco

    from dappo_batch.robots import Limb

__all__ = ["DamageType", "MovingLimits"]


@dataclass(frozen=True)
class MovingLimits:
    """Limits of a hinge that move with its position at the onset of the damage.

    Attributes
    ----------
    joint : str
        Name of the joint.
    compiled_at : float
        The position for which `DamageType.apply` has written the limits, rad.
    range : tuple of float
        Lowest and highest position that counts, rad: the position at the onset is clipped to it.
    share : float
        By how much both limits move, as a share of the distance of the position from `compiled_at`.
    """

    joint: str
    compiled_at: float
    range: tuple[float, float]
    share: float


class DamageType(ABC):
    """A kind of damage of a limb, as an edit of the MJCF before it is compiled.

    A damage type never edits a compiled model: masses, inertias, bounding volumes and inverse weights
    depend on each other, and only MuJoCo's compiler derives all of them.

    A concrete type is a frozen dataclass. Its fields are the entries of the table ``[damage.<name>]`` in a
    robot TOML; it checks their values in ``__post_init__``.
    """

    name: ClassVar[str]
    """Name of the type in robot TOMLs, class names and damage specs."""

    disables_touch: ClassVar[bool] = False
    """Whether the touch signal of a damaged limb reads 0."""

    removes_parts: ClassVar[bool] = False
    """Whether parts of the limb are gone; a limb cannot have two such types at once."""

    @abstractmethod
    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Damage one limb.

        Parameters
        ----------
        spec : mujoco.MjSpec
            The robot, edited in place. No array of the compiled model may change its size.
        limb : Limb
            The limb to damage. Only its parts may change, because limbs are damaged one after the other.
        severity : float
            In (0, 1]; 1 is the full damage.

        Raises
        ------
        ConfigError
            If the limb cannot be damaged in this way.
        """

    def moving_limits(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> MovingLimits | None:
        """Return which limits of a joint follow its position at the onset; None, the default, for none.

        Parameters
        ----------
        spec : mujoco.MjSpec
            The robot before the damage.
        limb : Limb
            The damaged limb.
        severity : float
            In (0, 1].
        """
        return None
