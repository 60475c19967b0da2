"""Keeping freed memory in the process: pages fetched anew for every update cost as much as half its arithmetic."""

from __future__ import annotations

import ctypes

M_TRIM_THRESHOLD = -1
M_MMAP_THRESHOLD = -3
M_ARENA_MAX = -8
TRIM_THRESHOLD = 2**30  # bytes
MMAP_THRESHOLDS = (2**30, 2**25)  # bytes; the first is far above the largest tensor, glibc before 2.35 takes the second


def keep_freed_memory() -> bool:
    """Tell glibc to hand freed memory out again rather than back to the system; for the whole process.

    What LD_PRELOAD of tcmalloc does, without a launcher. Call it before there is a second thread: what a thread frees
    is kept only in the memory that all share from then on, not in one of its own. -> whether all switches took effect;
    False where the C library has none.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    unmapped = any(mallopt(M_MMAP_THRESHOLD, threshold) for threshold in MMAP_THRESHOLDS)
    untrimmed = bool(mallopt(M_TRIM_THRESHOLD, TRIM_THRESHOLD))
    shared = bool(mallopt(M_ARENA_MAX, 1))
    return unmapped and untrimmed and shared
