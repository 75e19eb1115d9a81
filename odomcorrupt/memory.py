"""Memory settings of the C library for this process."""

from __future__ import annotations

import ctypes
import sys

__all__ = ["keep_freed_memory"]

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Names of parameters in glibc's malloc.h."""
_KEPT_BYTES = 32 << 20


def keep_freed_memory() -> None:
    """Keep freed memory in the process instead of returning it to the kernel, with glibc.

    Codecs allocate memory for each chunk, and getting it from the kernel takes longer than decompressing into it.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _KEPT_BYTES)
        mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
