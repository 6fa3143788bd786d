"""Opening what lies in a run's folder: files that have an end, and nothing else."""

from __future__ import annotations

import errno
from pathlib import Path


def regular(path: Path) -> Path:
    """Return a path that may be opened.

    Raises:
        OSError: a pipe, a device or a folder lies there; reading one would wait, or go on, for ever.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file")
    return path
