"""How the dense stage is given more than one core: by a `map`, on which no result depends."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

# Like `map`, in order. One that may run in other processes takes one iterable, and what can be pickled.
Mapper = Callable[..., Iterable[Any]]
