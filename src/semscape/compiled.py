"""Compiled kernels whose cache on disk any number of processes may fill at the same time.

Numba numbers the files of a function's compiled types, and keeps in an index which is which. Two processes that compile
two types at once both take the same number: one type's file then holds the other's code, and every process that reads
it later fails ("can't unbox array"), or reads arrays in the wrong order. Here a file is named after its type and says
whose it is; there is no index.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import IndexDataCacheFile

Function = TypeVar("Function", bound=Callable[..., Any])


def njit(*, cache: bool = False, **options: Any) -> Callable[[Function], Function]:
    """Compile a function as `numba.njit` does, but `cache` it in files that processes can share.

    Parameters
    ----------
    cache : bool
        Keep what is compiled on disk.
    **options
        Of `numba.njit`.

    Returns
    -------
    callable
        A decorator.

    Examples
    --------
    >>> @njit(nogil=True)
    ... def twice(x):
    ...     return 2 * x
    >>> twice(4)
    8
    """

    def compiled(function: Function) -> Function:
        kernel: Any = numba.njit(**options)(function)
        if cache:
            with suppress(RuntimeError):  # no cache where neither the package's folder nor the user's can be written
                kernel.enable_caching()
                kernel._cache._cache_file.__class__ = FilePerType
        return cast(Function, kernel)

    return compiled


class FilePerType(IndexDataCacheFile):
    """The files of one function: one for each of the types that it was compiled for."""

    def save(self, key: Any, data: Any) -> None:
        """Keep what was compiled under a key of types, processor and code; a cache that cannot be written is none."""
        with suppress(OSError):
            self._save_data(self._file_name(key), (self._source_stamp, key, data))  # type: ignore[no-untyped-call]

    def load(self, key: Any) -> Any:
        """Return what was compiled; None where there is nothing, or what is there is damaged, old or another's."""
        try:
            stamp, kept_key, data = self._load_data(self._file_name(key))  # type: ignore[no-untyped-call]
        except Exception:  # noqa: BLE001 (half a file fails in many ways after the power was off)
            return None
        return data if (stamp, kept_key) == (self._source_stamp, key) else None

    def _file_name(self, key: Any) -> str:
        types, processor, _ = key
        told = f"{self._version} {processor} {types}"
        return str(self._data_name_pattern.format(number=int(hashlib.sha256(told.encode()).hexdigest()[:12], 16)))
