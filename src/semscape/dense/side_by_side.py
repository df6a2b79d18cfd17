"""How the dense stage is given more than one core: by a `map`, on which no result depends."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

# Like `map`: in order, and with any number of iterables. Functions and what they take can be pickled.
Mapper = Callable[..., Iterable[Any]]
