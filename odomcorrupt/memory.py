"""What this process asks of the C library."""

from __future__ import annotations

import ctypes
import sys

__all__ = ["keep_freed_memory"]

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Names of parameters in glibc's malloc.h."""
_KEPT_BYTES = 32 << 20


def keep_freed_memory() -> None:
    """Have freed memory stay with the process, where the C library is glibc.

    Codecs return each chunk in fresh memory, and to get that from the kernel costs more than to unpack into it.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _KEPT_BYTES)
        mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)
