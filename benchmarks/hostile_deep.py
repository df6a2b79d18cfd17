"""Hostile inputs that get past the first checks: real-shaped series whose pixels match and whose rest is malicious.

Each maker writes a folder of three views of one simulated specimen and then spoils something deep inside: bytes of the
compressed pixels, values of TIFF's tags, a vendor's header, a sidecar, the pixels themselves, the kind of a file.
"""

from __future__ import annotations

import base64
import json
import os
import random
import socket
import struct
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image

from semscape.io.simulated import write_simulated_series
from semscape.simulate import SimulationOptions, simulate

_MICROSCOPE = SimulationOptions(tilts_deg=(-6.0, 0.0, 6.0), width_px=112, height_px=112)
_CORPUS = Path(__file__).with_name("fuzz_corpus.json")
_ZEISS, _FEI, _FEI_XML, _TESCAN = 34118, 34682, 34683, 50431

# Headers that say what is so; {} is the view's tilt in deg, and any number in them may become something else.
_FORMS: dict[str, str] = {
    "fei": "[User]\r\nDate=1\r\n[Beam]\r\nHV=10000\r\n[Scan]\r\nPixelWidth=5e-8\r\nPixelHeight=5e-8\r\nTotal=112\r\n"
    "[Stage]\r\nStageT={}\r\nStageR=1.5\r\nWorkingDistance=0.01\r\n[Image]\r\nResolutionX=112\r\nResolutionY=112\r\n",
    "fei xml": "<Metadata><Optics><WorkingDistance>0.01</WorkingDistance><AccelerationVoltage>10000"
    "</AccelerationVoltage></Optics><StageSettings><StagePosition><Tilt><Alpha>{}</Alpha></Tilt></StagePosition></StageSettings>"
    '<BinaryResult><PixelSize><X unit="m">5e-8</X><Y unit="m">5e-8</Y></PixelSize></BinaryResult></Metadata>',
    "tescan": "[MAIN]\nDevice=MIRA3\nPixelSizeX=5e-8\nPixelSizeY=5e-8\nImageStripSize=0\n[SEM]\n"
    "HV=10000\nStageTilt={}\nWD=0.01\nTiltCorrection=0\n",
    "jeol": "$CM_FORMAT JPEG\n$CM_MAG 1000\n$CM_FULL_SIZE 112 112\n$$SM_MICRON_BAR 20\n$$SM_MICRON_MARKER 1um\n"
    "$CM_ACCEL_VOLT 10\n$CM_STAGE_POS 1 2 3 {} 0 0\n",
    "hitachi": "[SemImageFile]\nInstructName=S-4800\nPixelSize=50\nDataSize=112x112\nStagePositionT={}\n"
    "Magnification=1000\nAcceleratingVoltage=10000 Volt\nWorkingDistance=10000 um\n",
    "phenom": '<FeiImage><pixelWidth unit="nm">50</pixelWidth><pixelHeight unit="nm">50</pixelHeight><magnification>'
    "1000</magnification><databarHeight>0</databarHeight><acceleratingVoltage>10000</acceleratingVoltage></FeiImage>",
    "imagej": "ImageJ=1.53\nunit=um\nmin=0\nmax=255\n",
    "ome": '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image><Pixels PhysicalSizeX="0.05" '
    'PhysicalSizeY="0.05" PhysicalSizeXUnit="um" SizeX="112" SizeY="112" Type="uint8"/></Image></OME>',
}
_VALUES = [
    "", "-", "nan", "inf", "-inf", "1e999", "-1e999", "1e-320", "0", "-0.0", "-5", "90", "-89.999", "361", "1e30",
    "9" * 400, "0x10", "1,5", "1.2.3", "१२", "∞", "5 mm", "1e9 parsec", "true", "\0", "\x1b[31m", "\x85\u2028",
    "<script>alert(1)</script>", "%s%s%n", "../../../../etc/passwd", "a" * 100_000, "&lol;", "\ud7ff\ufffe",
    "[[[", "<" * 2000, "=1+1",
]  # fmt: skip


@cache
def _pixels() -> tuple[tuple[str, np.ndarray, bytes], ...]:
    """Return name, grey values and file of each view; simulated once in a process."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        write_simulated_series(Path(folder), *simulate("fracture", _MICROSCOPE, rng=3))
        found = sorted(Path(folder).glob("*.tif"))
        return tuple((path.name, tifffile.imread(path), path.read_bytes()) for path in found)


def _real(folder: Path) -> list[Path]:
    """Write the three views as they come from the microscope."""
    paths = []
    for name, _, content in _pixels():
        paths.append(folder / name)
        paths[-1].write_bytes(content)
    return paths


def _rewritten(folder: Path, dice: random.Random, texts: list[bytes], tag: int, **options: Any) -> list[Path]:
    """Write the views anew, with a text in a tag of each."""
    paths = []
    for (name, image, _), text in zip(_pixels(), texts, strict=True):
        paths.append(folder / name)
        kind: Any = dice.choice(["s", "B"])
        value = text if kind == "B" else text.replace(b"\0", b" ")
        extra = [(tag, kind, len(value) if kind == "B" else 0, value, True)] if value else []
        tifffile.imwrite(paths[-1], image, extratags=extra, metadata=None, **options)
    return paths


def _some(dice: random.Random, items: list[Any]) -> list[Any]:
    return dice.sample(items, dice.choice([1, 1, len(items)]))


def special_files(folder: Path, dice: random.Random) -> None:
    """A pipe that nobody writes to, links to devices, a socket: in the place of an image or of a text."""
    image = dice.choice(_real(folder))
    name = dice.choice([image.name, image.name, "series.toml", image.stem + ".txt", image.stem + ".hdr"])
    path = folder / name
    path.unlink(missing_ok=True)
    kind = dice.choice(
        ["pipe", "pipe", "/dev/zero", "/dev/urandom", "/dev/full", "/dev/tty", "/proc/self/mem", "socket"]
    )
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket" and len(str(path)) < 100:
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(path))
    else:
        path.symlink_to(kind if kind != "socket" else "/dev/null")


def packed_bombs(folder: Path, dice: random.Random) -> None:
    """Complete files of some kB: a field of one value, or one that repeats, strips that hold far more than is said."""
    side = dice.choice([1500, 2000, 4400])
    period = dice.choice([0, 2, 16, 50])  # of dots; 0: none
    kind = dice.choice(["zlib", "lzma", "zstd", "png", "overfull", "text"])
    for index, path in enumerate(_some(dice, _real(folder))):
        path.unlink()
        field = np.zeros((side, side), np.uint8)
        if period:  # each view its own, for the same image twice is refused at once
            field[index::period, 3 * index :: period] = 200 + index
        if kind == "png":
            Image.fromarray(field).save(path.with_suffix(".png"), compress_level=9)
        elif kind == "overfull":  # 112 x 112 px whose strip unpacks to 300 MB
            packed = zlib.compress(bytes(300_000_000), 9)
            tags = [(256, 4, 112), (257, 4, 112), (258, 3, 8), (259, 3, 8), (262, 3, 1), (273, 4, 200), (277, 3, 1),
                    (278, 4, 112), (279, 4, len(packed))]  # fmt: skip
            head = struct.pack("<2sHIH", b"II", 42, 8, len(tags))
            body = b"".join(struct.pack("<HHII", code, form, 1, value) for code, form, value in tags)
            path.write_bytes((head + body).ljust(200, b"\0") + packed)
        elif kind == "text":  # a PNG whose comment unpacks to 300 MB

            def chunk(name: bytes, data: bytes) -> bytes:
                return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

            image = _pixels()[0][1]
            start = chunk(b"IHDR", struct.pack(">IIBBBBB", image.shape[1], image.shape[0], 8, 0, 0, 0, 0))
            comment = chunk(b"zTXt", b"Comment\0\0" + zlib.compress(bytes(300_000_000), 9))
            rows = chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row.tobytes() for row in image)))
            content = b"\x89PNG\r\n\x1a\n" + start + comment + rows + chunk(b"IEND", b"")
            path.with_suffix(".png").write_bytes(content)
        else:
            tifffile.imwrite(path, field, compression=kind, rowsperstrip=side, metadata=None)


def spoiled_pixels(folder: Path, dice: random.Random) -> None:
    """Bits flipped in the data of the strips alone: each decoder's own checks must find them, or the image is noise."""
    names = {"compression": dice.choice([None, "zlib", "lzw", "jpeg", "packbits", "zstd", "lzma", "png", "jpeg2000"])}
    if names["compression"] in ("zlib", "lzw") and dice.random() < 0.5:
        names["predictor"] = True
    if dice.random() < 0.4:
        names["tile"] = (16, 16)
    for path in _some(dice, _rewritten(folder, dice, [b""] * 3, _ZEISS, **names)):
        with tifffile.TiffFile(path) as tiff:
            offsets, counts = tiff.pages.first.dataoffsets, tiff.pages.first.databytecounts
        content = bytearray(path.read_bytes())
        for _ in range(dice.choice([1, 5, 200])):
            strip = dice.randrange(len(offsets))
            if counts[strip]:
                content[offsets[strip] + dice.randrange(counts[strip])] ^= 1 << dice.randrange(8)
        path.write_bytes(content)


def spoiled_tags(folder: Path, dice: random.Random) -> None:
    """Fields of the image file directory changed: types, counts, values, the next directory's place."""
    for path in _some(dice, _real(folder)):
        content = bytearray(path.read_bytes())
        order = "<" if content[:2] == b"II" else ">"
        start = struct.unpack_from(order + "I", content, 4)[0]
        count = struct.unpack_from(order + "H", content, start)[0]
        for _ in range(dice.choice([1, 1, 2, 4])):
            place = start + 2 + 12 * dice.randrange(count)
            what = dice.choice(["code", "type", "count", "value", "next", "loop"])
            if what == "code":
                code = dice.choice(
                    [0, 270, 274, 277, 282, 284, 305, 306, 317, 330, 338, 339, 34118, 34665, 50431, 65535]
                )
                struct.pack_into(order + "H", content, place, code)
            elif what == "type":
                struct.pack_into(order + "H", content, place + 2, dice.choice([0, 1, 2, 5, 7, 11, 12, 16, 99]))
            elif what == "count":
                struct.pack_into(order + "I", content, place + 4, dice.choice([0, 2, 255, 65_536, 2**31, 2**32 - 1]))
            elif what == "value":
                value = dice.choice([0, 1, 2, 3, 8, 16, 64, start, len(content) - 1, 2**31, 2**32 - 1])
                struct.pack_into(order + "I", content, place + 8, value)
            else:
                following = start if what == "loop" else dice.randrange(len(content))
                struct.pack_into(order + "I", content, start + 2 + 12 * count, following)
        path.write_bytes(content)


def spoiled_headers(folder: Path, dice: random.Random) -> None:
    """Some vendor's header, right but for a few values, lines or bytes."""
    vendor = dice.choice([*_FORMS, "zeiss", "zeiss"])
    tilts = [-6.0, 0.0, 6.0]
    if vendor == "zeiss":
        with tifffile.TiffFile(_real(folder)[0]) as tiff:
            tag = tiff.pages.first.tags[_ZEISS]
            start = tag.valueoffset
            texts = [content[start : start + tag.valuebytecount].decode("cp1252") for _, _, content in _pixels()]
    else:
        texts = [_FORMS[vendor].format(np.deg2rad(tilt) if vendor.startswith("fei") else tilt) for tilt in tilts]
    spoiled = [_spoiled(text, dice) if i in _some(dice, [0, 1, 2]) else text for i, text in enumerate(texts)]
    raw = [text.encode("utf-8", "surrogatepass") for text in spoiled]
    if vendor in ("tescan", "jeol", "hitachi"):
        for path, text in zip(_rewritten(folder, dice, [b""] * 3, _ZEISS), raw, strict=True):
            path.with_suffix(".hdr" if vendor == "tescan" else ".txt").write_bytes(text)
        return
    tag = {"zeiss": _ZEISS, "fei": _FEI, "fei xml": _FEI_XML, "phenom": _FEI_XML, "imagej": 270, "ome": 270}[vendor]
    _rewritten(folder, dice, raw, tag)


def _spoiled(text: str, dice: random.Random) -> str:
    """Return a text with some of its values replaced, lines doubled, taken out or run together, or bytes changed."""
    import re

    for _ in range(dice.choice([1, 1, 3, 8])):
        how = dice.choice(["value", "value", "value", "line", "twice", "byte"])
        numbers = [found.span() for found in re.finditer(r"-?\d+(\.\d+)?(e-?\d+)?", text)]
        if how == "value" and numbers:
            start, end = dice.choice(numbers)
            text = text[:start] + dice.choice(_VALUES) + text[end:]
        elif how in ("line", "twice"):
            lines = text.splitlines(keepends=True)
            index = dice.randrange(len(lines))
            lines[index : index + 1] = [lines[index]] * (0 if how == "line" else dice.choice([2, 500]))
            text = "".join(lines) or "-"
        else:
            index = dice.randrange(len(text))
            text = text[:index] + chr(dice.randrange(256)) + text[index + 1 :]
    return text


def fuzzed_headers(folder: Path, dice: random.Random) -> None:
    """What coverage-guided fuzzing of the readers kept (fuzz_corpus.json), in the tags and sidecars of good images."""
    found = base64.b64decode(dice.choice(_corpus()))[1:]
    tag = dice.choice([_ZEISS, _FEI, _FEI_XML, _TESCAN, 270])
    texts = [found if i in _some(dice, [0, 1, 2]) else b"" for i in range(3)]
    paths = _rewritten(folder, dice, texts, tag)
    if dice.random() < 0.4:
        dice.choice(paths).with_suffix(dice.choice([".txt", ".hdr"])).write_bytes(found)


@cache
def _corpus() -> list[str]:
    texts: list[str] = json.loads(_CORPUS.read_text(encoding="ascii"))
    return texts


def hostile_sidecars(folder: Path, dice: random.Random) -> None:
    """A series.toml in good form whose values are none, or a microscope's only in theory."""
    names = [path.name for path in _real(folder)]
    values = {
        "pixel_size_um": ["1e-300", "1e300", "5e-324", "1e18", "1e-9", "0", "nan"],
        "axis_deg": ["90", "44.9", "-44.9", "134.9", "1e18", "-1e300", "360", "inf"],
        "data_bar_rows": ["0", "1", "60", "100", "111", "112", "-1"],
        "tilts_deg": ["[0,0,0]", "[90,0,-90]", "[1e-12,0,-1e-12]", "[89.99,0,1]", "[6,6,6]", "[6,0,-6]", "[-6,0,nan]"],
        "tilt_correction_deg": ["90", "-90", "89.9", "1e-300", "0", "91"],
    }
    keys = dice.sample(list(values), dice.choice([1, 1, 2]))
    lines = [f"{key} = {dice.choice(values[key])}" for key in keys]
    if "tilts_deg" not in keys and dice.random() < 0.4:
        lines.append(f'[images."{dice.choice(names)}"]\ntilt_deg = {dice.choice(["45", "-90", "1e-9", "6.0", "1e9"])}')
    (folder / "series.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def odd_pixels(folder: Path, dice: random.Random) -> None:
    """Good files of pixels that no specimen has: constant, a chessboard, all views the same, infinite, huge, turned."""
    rng = np.random.default_rng(dice.getrandbits(32))
    kinds = ["constant", "board", "same", "huge", "nan", "turned", "mirrored", "noise", "two", "stripes", "int16"]
    kind = dice.choice([*kinds, "dots", "saturated", "other"])
    views = [image for _, image, _ in _pixels()]
    first = views[0]
    y, x = np.mgrid[:112, :112]
    if kind == "other":  # one view of another specimen
        views[dice.randrange(3)] = np.roll(first[::-1, ::-1].T, 31, axis=0)
    made: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "constant": lambda image: np.full_like(image, 77),
        "board": lambda _: ((x // 8 + y // 8) % 2 * 200).astype(np.uint8),
        "same": lambda _: first,
        "huge": lambda image: image.astype(np.float32) * np.float32(1e36),
        "nan": lambda image: np.where(image > 100, np.nan, image).astype(np.float32),
        "turned": lambda image: np.rot90(image, dice.randrange(4)).copy(),
        "mirrored": lambda image: image[:, ::-1].copy() if dice.random() < 0.5 else image,
        "noise": lambda image: rng.integers(0, 256, image.shape, np.uint8),
        "two": lambda image: np.where(image > np.median(image), 255, 0).astype(np.uint8),
        "stripes": lambda _: (np.sin(x / 2.0) * 100 + 120).astype(np.uint8),
        "int16": lambda image: ((image.astype(np.int32) - 128) * 255).astype(np.int16),
        "dots": lambda _: ((x % 9 < 2) & (y % 9 < 2)).astype(np.uint8) * 250,
        "saturated": lambda image: np.where(image > 60, 255, 0).astype(np.uint8),
        "other": lambda image: image,
    }
    for (name, _, _), image in zip(_pixels(), views, strict=True):
        tifffile.imwrite(folder / name, made[kind](image), metadata=None)


def hostile_names(folder: Path, dice: random.Random) -> None:
    """Good images under names that mean something to shells, pages, terminals and file systems."""
    names = ["<script>alert(1)</script>", "a" * 250, "\u202egpj", "\x1b[31mred", "$(reboot)", "-o", "a\nb", "a'b\"c"]
    names += ["%00", "é" * 60, "..\\..\\x", "{0}{1}", "&amp;"]
    for index, path in enumerate(_real(folder)):
        if dice.random() < 0.7:
            name = f"{index}{dice.choice(names)}"[:251] if dice.random() < 0.5 else f"{dice.choice(names)[:240]}{index}"
            path.rename(folder / f"{name.replace('/', '_')}.tif")


DEEP_MAKERS: tuple[Callable[[Path, random.Random], None], ...] = (
    *(special_files, packed_bombs, spoiled_pixels, spoiled_tags, spoiled_headers, spoiled_headers, fuzzed_headers),
    *(hostile_sidecars, odd_pixels, hostile_names),
)
