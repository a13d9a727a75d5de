"""Objects that cannot be pickled."""

from __future__ import annotations

from typing import ClassVar, NoReturn, SupportsIndex

from dappo_batch._core import DappoError

__all__ = ["NotPicklable", "NotPicklableError"]


class NotPicklableError(DappoError, TypeError):
    """An object with native memory cannot be pickled or copied."""


class NotPicklable:
    """Base of classes whose state is native memory: `pickle` and `copy` raise with an alternative."""

    _instead: ClassVar[str]

    def __reduce_ex__(self, protocol: SupportsIndex, /) -> NoReturn:
        """Raise for every protocol."""
        raise NotPicklableError(
            f"a {type(self).__name__} cannot be pickled or copied, because its state is native memory; "
            f"{self._instead}"
        )
