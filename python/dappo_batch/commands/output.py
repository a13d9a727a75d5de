"""What the commands written in Python print."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable
from typing import Any

from dappo_batch._core import DappoError

__all__ = ["written"]


def written(command: Callable[..., int], **arguments: Any) -> int:  # noqa: ANN401 - those of `command`
    """Run a command, and see to it that what it prints is written.

    A closed pipe is no failure: whoever read it has seen enough.

    Raises
    ------
    DappoError
        If standard output cannot be written.
    """
    try:
        code = command(**arguments)
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        _discard()
        return 0
    except OSError as error:
        # An error of a file names it.
        if error.filename is not None or error.errno not in (
            errno.ENOSPC,
            errno.EIO,
            errno.EDQUOT,
            errno.EBADF,
        ):
            raise
        _discard()
        raise DappoError(f"cannot write to standard output: {error.strerror}") from error
    return code


def _discard() -> None:
    """Send what is left to nowhere, so that the interpreter does not try again at its end."""
    if sys.stdout is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
