"""Objects that belong to their process."""

from __future__ import annotations

from typing import ClassVar, NoReturn, SupportsIndex

from dappo_batch._core import DappoError

__all__ = ["NotPicklable", "NotPicklableError"]


class NotPicklableError(DappoError, TypeError):
    """An object that holds native memory was to be pickled or copied."""


class NotPicklable:
    """Base of classes whose state is native memory: `pickle` and `copy` refuse them and say what to do."""

    _instead: ClassVar[str]

    def __reduce_ex__(self, protocol: SupportsIndex, /) -> NoReturn:
        """Refuse, whatever the protocol."""
        raise NotPicklableError(
            f"a {type(self).__name__} cannot be pickled or copied, because its state is native memory; "
            f"{self._instead}"
        )
