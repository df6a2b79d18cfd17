"""A register tile of distances: the compiled heart of the nearest-neighbour search.

A matrix product keeps a small tile of the result in vector registers and runs over the dimensions. So does
this one, but nothing of the result is stored: while the tile is still in registers it is compared with what
each of its rows and columns has found so far, and only the rare tile that may improve one of them is looked
at. The tile is written as LLVM's own vector instructions, so that numba compiles it for the machine at hand.

A tile holds half squared distances without the row's share: starting from half a column's squared norm, the
products are subtracted. Four arithmetics fill it:

========  ==========================  ==========================================================
bytes     uint8, 4 to a lane          multiply-add of bytes into 32 bits (VNNI)
words     int16, 2 to a lane          multiply-add of 16-bit words into 32 bits (VNNI)
floats    float32                     fused multiply-add, in the order of the dimensions, everywhere
bits      uint8, 4 to a lane          exclusive or and population count
========  ==========================  ==========================================================
"""

# An intrinsic names its arguments for the compiler; what they hold is known only in `generate`.
# ruff: noqa: ARG001

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import config
from numba.core.codegen import get_host_cpu_features
from numba.extending import intrinsic

TILE_ROWS = 6


def _processor_features() -> set[str]:
    """Return the features of the processor that numba compiles for."""
    text: str | None = config.CPU_FEATURES  # type: ignore[attr-defined]
    if text is None:
        text = get_host_cpu_features()  # type: ignore[no-untyped-call]
    return {name.removeprefix("+") for name in text.split(",") if name.startswith("+")}


_HAS = _processor_features()
_WIDE = {"avx512f", "avx512bw", "avx512vl"} <= _HAS
# With 32 vector registers of 16 lanes a tile is 6 x 64; with 16 registers of 8 lanes 6 x 16.
LANES = 16 if _WIDE else 8
_VECTORS = 4 if _WIDE else 2
TILE_COLUMNS = LANES * _VECTORS
HAS_INTEGER_PRODUCTS = ("avx512vnni" if _WIDE else "avxvnni") in _HAS

_I32, _I64, _FLOAT = ir.IntType(32), ir.IntType(64), ir.FloatType()
_INTEGERS, _FLOATS = ir.VectorType(_I32, LANES), ir.VectorType(_FLOAT, LANES)
_ROWS, _VECTORS_OF_A_ROW = range(TILE_ROWS), range(_VECTORS)


def _call(builder: ir.IRBuilder, name: str, vector: ir.Type, arguments: list[Any]) -> Any:
    kind = ir.FunctionType(vector, [vector] * len(arguments))
    return builder.call(builder.module.declare_intrinsic(name, fnty=kind), arguments)


def _dot_product_of(name: str) -> Callable[..., Any]:
    def step(builder: ir.IRBuilder, total: Any, a: Any, b: Any) -> Any:
        return _call(builder, f"llvm.x86.avx512.{name}.{32 * LANES}", _INTEGERS, [total, a, b])

    return step


def _multiply_add(builder: ir.IRBuilder, total: Any, a: Any, b: Any) -> Any:
    return _call(builder, f"llvm.fma.v{LANES}f32", _FLOATS, [a, b, total])


def _count_differing_bits(builder: ir.IRBuilder, total: Any, a: Any, b: Any) -> Any:
    return builder.add(total, _call(builder, f"llvm.ctpop.v{LANES}i32", _INTEGERS, [builder.xor(a, b)]))


# The arithmetic goes by the element type of the packed rows.
_STEPS: dict[types.Type, Callable[..., Any]] = {
    types.uint8: _dot_product_of("vpdpbusd"),
    types.int16: _dot_product_of("vpdpwssd"),
    types.float32: _multiply_add,
    types.uint32: _count_differing_bits,
}


@intrinsic
def _compare_tile(  # type: ignore[no-untyped-def]
    typingctx,
    panels,
    panel,
    tile,
    start,
    row_limit,
    row_share,
    column_limit,
    out,
    better,
    groups,
):
    """Fill a tile, compare it, and tell whether a row or a column may improve.

    Parameters
    ----------
    typingctx
        Numba's own.
    panels : array
        The packed rows; its element type chooses the arithmetic.
    panel, tile : int
        Addresses of the packed rows (groups x TILE_ROWS lanes) and columns (groups x TILE_COLUMNS lanes).
    start, row_limit, row_share, column_limit : int
        Addresses of what the columns start from, of what the rows must fall below, of the rows' share in what
        the columns must fall below.
    out, better : int
        Addresses where, if any may improve, the tile is written and two words of bits for each of its rows: the
        columns that may improve the row, and those that the row may improve.
    groups : int
        Number of lanes that a descriptor takes.
    """
    step = _STEPS[panels.dtype]
    lane = _FLOAT if panels.dtype == types.float32 else _I32

    def generate(_context: Any, builder: ir.IRBuilder, _signature: Any, arguments: Any) -> Any:
        return _TileWriter(builder, lane, step).write(*arguments[1:])

    return types.boolean(panels, *[types.int64] * 9), generate


@intrinsic
def _lowest_bit(typingctx, word):  # type: ignore[no-untyped-def]
    """Return the index of the lowest bit that is set in a word of 64."""

    def generate(_context: Any, builder: ir.IRBuilder, _signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), True))

    return types.int64(types.uint64), generate


# What the compiler sees has no typing context as its first argument.
compare_tile: Any = _compare_tile
lowest_bit: Any = _lowest_bit


class _TileWriter:
    """Writes the LLVM instructions of one tile."""

    def __init__(self, builder: ir.IRBuilder, lane: ir.Type, step: Callable[..., Any]) -> None:
        self.builder, self.lane, self.step = builder, lane, step
        self.vector = ir.VectorType(lane, LANES)
        self.fetch = builder.load

    def write(self, *arguments: Any) -> Any:
        """Write all of it for the arguments of `compare_tile`; returns whether any row or column may improve."""
        *addresses, out, better, groups = arguments
        panel, tile, start, row_limit, row_share, column_limit = map(self._lanes, addresses)
        sums = self._sums(panel, tile, start, groups)
        limits = [self._splat(row_limit, r) for r in _ROWS]
        shares = [self._splat(row_share, r) for r in _ROWS]
        columns = [self._load(column_limit, v) for v in _VECTORS_OF_A_ROW]
        whole = [[self._add(value, share) for value in row] for row, share in zip(sums, shares, strict=True)]
        found = [self._less(self._least(row), limit) for row, limit in zip(sums, limits, strict=True)]
        found += [self._less(self._least([row[v] for row in whole]), columns[v]) for v in _VECTORS_OF_A_ROW]

        builder = self.builder
        any_found = self._bits([reduce(builder.or_, found)])
        one = builder.icmp_unsigned("!=", any_found, ir.Constant(_I64, 0))
        with builder.if_then(one, likely=False):
            lanes, words = self._lanes(out), builder.inttoptr(better, _I64.as_pointer())
            for r in _ROWS:
                for v in _VECTORS_OF_A_ROW:
                    builder.store(sums[r][v], self._vector_at(lanes, r * _VECTORS + v), align=4)
                improving = self._bits([self._less(value, limits[r]) for value in sums[r]])
                improved = self._bits([self._less(value, columns[v]) for v, value in enumerate(whole[r])])
                builder.store(improving, builder.gep(words, [ir.Constant(_I64, 2 * r)]))
                builder.store(improved, builder.gep(words, [ir.Constant(_I64, 2 * r + 1)]))
        return one

    def _sums(self, panel: Any, tile: Any, start: Any, groups: Any) -> list[list[Any]]:
        """Run over the dimensions with the whole tile in registers."""
        builder = self.builder
        first = [self._load(start, v) for v in _VECTORS_OF_A_ROW]
        before, body = builder.block, builder.append_basic_block("dimensions")
        builder.branch(body)
        builder.position_at_end(body)
        group = builder.phi(_I64)
        totals = [[builder.phi(self.vector) for _ in _VECTORS_OF_A_ROW] for _ in _ROWS]
        a_here = builder.gep(panel, [builder.mul(group, ir.Constant(_I64, TILE_ROWS))])
        b_here = builder.gep(tile, [builder.mul(group, ir.Constant(_I64, TILE_COLUMNS))])
        b = [self._load(b_here, v) for v in _VECTORS_OF_A_ROW]
        a = [self._splat(a_here, r) for r in _ROWS]
        sums = [[self.step(builder, totals[r][v], a[r], b[v]) for v in _VECTORS_OF_A_ROW] for r in _ROWS]
        following = builder.add(group, ir.Constant(_I64, 1))
        group.add_incoming(ir.Constant(_I64, 0), before)
        group.add_incoming(following, body)
        for r in _ROWS:
            for v in _VECTORS_OF_A_ROW:
                totals[r][v].add_incoming(first[v], before)
                totals[r][v].add_incoming(sums[r][v], body)
        after = builder.append_basic_block("compare")
        builder.cbranch(builder.icmp_signed("<", following, groups), body, after)
        builder.position_at_end(after)
        return sums

    def _bits(self, masks: list[Any]) -> Any:
        """Return the lanes of one to four masks as the bits of one word."""
        builder = self.builder
        word: Any = ir.Constant(_I64, 0)
        for v, mask in enumerate(masks):
            bits = builder.zext(builder.bitcast(mask, ir.IntType(LANES)), _I64)
            word = builder.or_(word, builder.shl(bits, ir.Constant(_I64, v * LANES)))
        return word

    def _lanes(self, address: Any) -> Any:
        return self.builder.inttoptr(address, self.lane.as_pointer())

    def _vector_at(self, lanes: Any, index: int) -> Any:
        place = self.builder.gep(lanes, [ir.Constant(_I64, index * LANES)])
        return self.builder.bitcast(place, self.vector.as_pointer())

    def _load(self, lanes: Any, index: int) -> Any:
        return self.fetch(self._vector_at(lanes, index), align=4)

    def _splat(self, lanes: Any, index: int) -> Any:
        value = self.fetch(self.builder.gep(lanes, [ir.Constant(_I64, index)]))
        nothing = ir.Constant(self.vector, ir.Undefined)
        one = self.builder.insert_element(nothing, value, ir.Constant(_I32, 0))
        return self.builder.shuffle_vector(one, nothing, ir.Constant(_INTEGERS, [0] * LANES))

    def _less(self, a: Any, b: Any) -> Any:
        compare = self.builder.fcmp_ordered if self.lane is _FLOAT else self.builder.icmp_signed
        return compare("<", a, b)

    def _least(self, values: list[Any]) -> Any:
        least = values[0]
        for value in values[1:]:
            least = self.builder.select(self._less(value, least), value, least)
        return least

    def _add(self, a: Any, b: Any) -> Any:
        return self.builder.fadd(a, b) if self.lane is _FLOAT else self.builder.add(a, b)
