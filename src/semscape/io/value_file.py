"""Values of semscape as bytes and back, exactly: frozen dataclasses, arrays, tuples, lists, dicts and plain values.

No pickle: such a file comes from a run folder, and reading it must not run code that somebody put there. Layout: a
line with the format, the SHA-256 of all that follows, the length of a JSON tree, the tree, and the arrays' bytes.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

_FORMAT = b"semscape value 1\n"
_DIGEST_BYTES = 32


def encode_value(value: Any) -> bytes:
    """Return a value as bytes.

    Raises
    ------
    TypeError
        For a value of a kind that has no place in such a file.
    """
    blobs: list[bytes] = []
    tree = json.dumps(_tree(value, blobs)).encode()
    body = b"".join([len(tree).to_bytes(8, "little"), tree, *blobs])
    return _FORMAT + hashlib.sha256(body).digest() + body


def decode_value(content: bytes) -> Any:
    """Return the value that `encode_value` made bytes of.

    Raises
    ------
    ValueError
        If the bytes are of another format, or have been changed, or cut.

    Examples
    --------
    >>> decode_value(encode_value({"xy": (1, 2.5, None)}))
    {'xy': (1, 2.5, None)}
    """
    start = len(_FORMAT) + _DIGEST_BYTES
    if not content.startswith(_FORMAT):
        raise ValueError("not a value of this semscape")
    body = memoryview(content)[start:]
    if hashlib.sha256(body).digest() != content[len(_FORMAT) : start]:
        raise ValueError("its digest does not fit: it is damaged")
    length = int.from_bytes(body[:8], "little")
    return _value(json.loads(bytes(body[8 : 8 + length])), body[8 + length :])


def _tree(value: Any, blobs: list[bytes]) -> Any:
    """Return the JSON tree of a value: plain values stand for themselves, all others are one-key tables."""
    if value is None or isinstance(value, bool | int | float | str):
        return float(value) if isinstance(value, np.float64) else value
    if isinstance(value, np.ndarray | np.generic):
        return {"array": _array_tree(np.asarray(value), blobs) | {"number": isinstance(value, np.generic)}}
    if isinstance(value, tuple) and type(value) is tuple:
        return {"tuple": [_tree(item, blobs) for item in value]}
    if isinstance(value, list):
        return {"list": [_tree(item, blobs) for item in value]}
    if isinstance(value, Mapping):
        return {"dict": [[_tree(key, blobs), _tree(item, blobs)] for key, item in value.items()]}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        kind = type(value)
        fields = {spec.name: _tree(getattr(value, spec.name), blobs) for spec in dataclasses.fields(value)}
        return {"class": f"{kind.__module__}:{kind.__qualname__}", "fields": fields}
    raise TypeError(f"{type(value).__name__} has no place in a file of values: {value!r}")


def _array_tree(array: np.ndarray[Any, Any], blobs: list[bytes]) -> dict[str, Any]:
    """Store an array's bytes; its order too, for sums and products depend on it in their last bit."""
    if array.dtype.hasobject:
        raise TypeError("an array of objects has no place in a file of values")
    order = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"
    stored = array
    if array.dtype == np.float32 and array.size:  # SIFT descriptors are whole numbers below 256
        with np.errstate(invalid="ignore"):
            small = array.astype(np.uint8)
        if np.array_equal(small.astype(np.float32).view(np.uint32), np.ascontiguousarray(array).view(np.uint32)):
            stored = small
    tree = {
        "dtype": array.dtype.str,
        "stored": stored.dtype.str,
        "shape": list(array.shape),
        "order": order,
        "at": sum(map(len, blobs)),
    }
    blobs.append(stored.tobytes(order="F" if order == "F" else "C"))
    return tree


def _value(tree: Any, arrays: memoryview) -> Any:
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        told = tree["array"]
        stored = np.dtype(told["stored"])
        count = int(np.prod(told["shape"], dtype=np.int64))
        flat = np.frombuffer(arrays, dtype=stored, count=count, offset=told["at"])
        array = flat.reshape(told["shape"], order=told["order"]).astype(np.dtype(told["dtype"]), order="K", copy=True)
        return array[()] if told["number"] else array
    if "tuple" in tree:
        return tuple(_value(item, arrays) for item in tree["tuple"])
    if "list" in tree:
        return [_value(item, arrays) for item in tree["list"]]
    if "dict" in tree:
        return {_value(key, arrays): _value(item, arrays) for key, item in tree["dict"]}
    return _class(tree["class"])(**{name: _value(item, arrays) for name, item in tree["fields"].items()})


def _class(name: str) -> Any:
    """Return one of semscape's own dataclasses by name, and nothing else."""
    module, _, qualname = name.partition(":")
    found = getattr(importlib.import_module(module), qualname, None) if module.startswith("semscape.") else None
    if not (isinstance(found, type) and dataclasses.is_dataclass(found)):
        raise ValueError(f"{name} is no value of semscape")
    return found
