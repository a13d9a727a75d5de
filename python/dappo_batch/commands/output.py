"""Standard output of the commands that are written in Python."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable
from typing import Any

from dappo_batch._core import DappoError

__all__ = ["written"]


def written(command: Callable[..., int], **arguments: Any) -> int:  # noqa: ANN401 - those of `command`
    """Run a command, and flush standard output.

    A closed pipe is not an error.

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
        # Errors of files have a file name.
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
    """Redirect buffered output to the null device, so that the interpreter does not fail at exit."""
    if sys.stdout is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
