"""Bad input at scale: every hostile folder or manifest must end in success or a SemscapeError, soon, in little memory.

`python benchmarks/hostile.py [COUNT]` tries 2,000 of them (or COUNT) in worker processes and prints JSON: how they
ended, and how far they got. Exit code 1 where one ended in anything else, took more than 10 s of CPU, waited for a
minute, or took more than 1 GB. A third of them is damaged from the start, the others get deeper (hostile_deep.py).
"""

from __future__ import annotations

import contextlib
import json
import random
import signal
import struct
import sys
import tempfile
import threading
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image

from hostile_deep import DEEP_MAKERS
from semscape.batch.folder_run import reconstruct_folder
from semscape.batch.manifest import find_specimens
from semscape.batch.run import options_of_rows
from semscape.errors import SemscapeError
from semscape.io import micrograph
from semscape.io.image_file import decode_image
from semscape.io.series import load_series
from semscape.options import Options, read_toml
from semscape.pipeline import reconstruct

MOST_S, MOST_MB = 10.0, 1000.0
_MOST_WAIT_S = 60.0
QUICK = Options().with_settings(
    [
        *("sfm.de_generations=2", "sfm.de_population_per_variable=2", "sfm.max_iterations=5"),
        *("dense.max_pairs=1", "dense.mesh_max_vertices=500"),
    ]
)
_SHAPE = (48, 64)
_TEXTS = [
    "", "\0", "nan", "1e999", "-1", "99999999999999999999", "../../etc/passwd", "/dev/zero", "C:\\con", "\x1b[2J",
    "%s%n", "☃" * 50, "=cmd|'/c calc'!A1", "[[[[", '"', "'''", "\ud7ff", "a" * 5000, "1,5", "-0.0", "true",
]  # fmt: skip


def _noise(random_numbers: random.Random, shape: tuple[int, int] = _SHAPE) -> np.ndarray:
    return np.random.default_rng(random_numbers.getrandbits(32)).integers(20, 230, shape, dtype=np.uint8)


def _good(folder: Path, dice: random.Random) -> list[Path]:
    """Write three good images, each of a kind that dice choose, with some vendor's header."""
    paths = []
    for name in "abc":
        image = _noise(dice)
        if dice.random() < 0.7:
            text = f"AP_STAGE_AT_T\r\nStage at T = {dice.uniform(-9, 9):.2f} deg\r\nAP_WD\r\nWD = {_text(dice)} mm\r\n"
            ini = f"[Scan]\r\nPixelWidth={_text(dice)}\r\n[Stage]\r\nStageT={_text(dice)}\r\n"
            tag = dice.choice([(34118, text), (34682, ini), (34680, ini), (51023, ini), (50431, ini), (270, ini)])
            content = tag[1].encode("utf-8", "replace")
            path = folder / f"{name}.tif"
            options = {"compression": dice.choice([None, "zlib", "lzw"])}
            tifffile.imwrite(path, image, extratags=[(tag[0], "s", 0, content, True)], metadata=None, **options)
        else:
            path = folder / f"{name}.{dice.choice(['png', 'jpg', 'bmp'])}"
            Image.fromarray(image).save(path)
        paths.append(path)
    return paths


def _text(dice: random.Random) -> str:
    return dice.choice([*_TEXTS, "5e-8", "0.1", "12"])


def _truncated(folder: Path, dice: random.Random) -> None:
    path = dice.choice(_good(folder, dice))
    content = path.read_bytes()
    path.write_bytes(content[: dice.randrange(len(content))])


def _flipped(folder: Path, dice: random.Random) -> None:
    path = dice.choice(_good(folder, dice))
    content = bytearray(path.read_bytes())
    for _ in range(dice.choice([1, 3, 30])):
        content[dice.randrange(len(content) if dice.random() < 0.5 else min(400, len(content)))] ^= 1 << dice.randrange(
            8
        )
    path.write_bytes(content)


def _random_bytes(folder: Path, dice: random.Random) -> None:
    magic = dice.choice([b"", b"II*\0", b"MM\0*", b"II+\0\x08\0\0\0", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe1", b"BM"])
    _good(folder, dice)[0].write_bytes(magic + dice.randbytes(dice.choice([0, 1, 60, 4000])))


def _odd_size(folder: Path, dice: random.Random) -> None:
    shape = dice.choice([(1, 1), (1, 64), (2, 2), (2, 3000), (3000, 2), (7, 9), (60_000, 2), (2, 60_000)])
    for path in _good(folder, dice)[: dice.choice([1, 3])]:
        path.unlink()
        tifffile.imwrite(path.with_suffix(".tif"), _noise(dice, shape), metadata=None)


def _bomb(folder: Path, dice: random.Random) -> None:
    """A file of some kB that says it is huge: TIFF with one zlib strip, or PNG."""
    side = dice.choice([20_000, 40_000, 65_535])
    packed = zlib.compress(bytes(10_000_000), 9)
    path = _good(folder, dice)[0]
    path.unlink()
    if dice.random() < 0.5:
        tags = [(256, 4, side), (257, 4, side), (258, 3, 8), (259, 3, 8), (262, 3, 1), (273, 4, 200), (277, 3, 1),
                (278, 4, side), (279, 4, len(packed))]  # fmt: skip
        head = struct.pack("<2sHIH", b"II", 42, 8, len(tags))
        body = b"".join(struct.pack("<HHII", code, kind, 1, value) for code, kind, value in tags)
        path.with_suffix(".tif").write_bytes((head + body).ljust(200, b"\0") + packed)
        return

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    start = chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0))
    path.with_suffix(".png").write_bytes(b"\x89PNG\r\n\x1a\n" + start + chunk(b"IDAT", packed) + chunk(b"IEND", b""))


def _sidecar(folder: Path, dice: random.Random) -> None:
    _good(folder, dice)
    keys = ["tilts_deg", "pixel_size_um", "axis_deg", "data_bar_rows", "images", "tilt_correction_deg", "x"]
    key = dice.choice(keys)
    value = dice.choice(
        [
            "[1,2,3]",
            "[nan,inf,1]",
            "-1",
            "1e400",
            '"../../x"',
            "true",
            "[[1]]",
            "{a=1}",
            "9" * 400,
            "[" * 900,
            _text(dice),
        ]
    )
    table = dice.choice(
        ["", '\n[images."../../../etc/passwd"]\ntilt_deg=3', '\n[images."a.tif"]\ntilt_deg=1e300', "\n[["]
    )
    content = f"{key} = {value}{table}\n".encode("utf-8", "replace")
    (folder / "series.toml").write_bytes(content if dice.random() < 0.9 else dice.randbytes(300))
    (folder / dice.choice(["a.txt", "a.hdr", "a-tif.hdr", "a.xml"])).write_text(
        f"[SemImageFile]\n$CM_MAG {_text(dice)}\nPixelSize={_text(dice)}\nTilt={_text(dice)}\n", errors="replace"
    )


def _odd_entries(folder: Path, dice: random.Random) -> None:
    path = _good(folder, dice)[0]
    path.unlink()
    kind = dice.choice(["empty", "folder", "loop", "dangling", "outside", "names"])
    if kind == "empty":
        path.touch()
    elif kind == "folder":
        path.mkdir()
    elif kind == "names":
        for name in ("con.tif", " .tif", "\x1b[31m.tif", "☃.tif", "-rf.tif"):
            tifffile.imwrite(folder / name, _noise(dice), metadata=None)
    else:
        path.symlink_to({"loop": path, "dangling": folder / "nowhere", "outside": "/etc/passwd"}[kind])


def _manifest(folder: Path, dice: random.Random) -> None:
    columns = dice.choice(["folder,name,tilts", "folder", "name", "folder;tilts", "folder,seed,options", "", "a,b\0"])
    lines = [",".join(_text(dice) for _ in range(dice.randrange(5))) for _ in range(dice.choice([0, 1, 5, 50]))]
    content = "\n".join([columns, *lines]).encode("utf-8", "replace")
    (folder / "MANIFEST.csv").write_bytes(content if dice.random() < 0.9 else dice.randbytes(500))


def _options(folder: Path, dice: random.Random) -> None:
    stage = dice.choice(["features", "dense", "run", "sfm", "nothing"])
    key = dice.choice(["ratio", "max_pairs", "seed", "max_tilt_deg", "x"])
    (folder / "options.toml").write_text(f"[{stage}]\n{key} = {_text(dice)}\n", encoding="utf-8", errors="replace")


MAKERS: tuple[Callable[[Path, random.Random], None], ...] = (
    *(_truncated, _flipped, _flipped, _random_bytes, _odd_size, _bomb, _sidecar, _sidecar),
    *(_odd_entries, _manifest, _options),
)


STAGES = ("refused unread", "read", "decoded", "metadata parsed", "matching", "calibrating", "surface", "whole run")
"""How far an input gets: `read`: an image fails to decode; `metadata parsed`: a view has nothing to match."""


class _Depth:
    """Notes how far a series gets."""

    def __init__(self) -> None:
        self.n_read = self.n_decoded = 0
        self.stage = ""

    def reached(self) -> str:
        read = "read" if self.n_read > self.n_decoded else "decoded" if self.n_decoded else "refused unread"
        return self.stage or read

    def decode(self, path: Path, data: bytes) -> Any:
        self.n_read += 1
        decoded = decode_image(path, data)
        self.n_decoded += 1
        return decoded

    def progress(self, stage: str, _: Any) -> None:
        begun = {"match": "matching", "calibrate": "calibrating", "surface": "surface", "mesh": "surface"}
        self.stage = begun.get(stage, self.stage)

    def run(self, folder: Path, out: Path | None) -> None:
        """Load and reconstruct; every few times into a run folder, with its report."""
        really, micrograph.decode_image = micrograph.decode_image, self.decode
        try:
            series = load_series(folder)
        finally:
            micrograph.decode_image = really
        self.stage = "metadata parsed"
        if out:
            reconstruct_folder(folder, out, QUICK, workers=1, progress=self.progress)
        else:
            reconstruct(series, QUICK, workers=1, progress=self.progress)
        self.stage = "whole run"


def _read_rows(folder: Path) -> None:
    options_of_rows(find_specimens(folder / "MANIFEST.csv", folder / "out"), Options())


def try_case(number: int) -> dict[str, Any]:
    """Make hostile input `number` of those that fail early, and tell how that ended."""
    return _tried(MAKERS[number % len(MAKERS)], number, "")


def try_deep_case(number: int) -> dict[str, Any]:
    """Make hostile input `number` of those that get past the first checks, and tell how that ended."""
    return _tried(DEEP_MAKERS[number % len(DEEP_MAKERS)], number, "deep-")


def _tried(maker: Callable[[Path, random.Random], None], number: int, kind: str) -> dict[str, Any]:
    from semscape.report.memory import PeakMemory

    depth = _Depth()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "set"
        folder.mkdir()
        maker(folder, random.Random(f"{kind}{number}" if kind else number))
        memory = PeakMemory()
        held_mb, start, cpu = memory.peak_mb(), time.perf_counter(), time.process_time()
        try:
            with _alarm():
                if (folder / "MANIFEST.csv").exists():
                    _read_rows(folder)
                elif (folder / "options.toml").exists():
                    read_toml((folder / "options.toml").read_text(encoding="utf-8"))
                else:
                    depth.run(folder, Path(name) / "out" if number % 7 == 0 else None)
            ended = "good"
        except SemscapeError as error:
            ended = "refused" if str(error) else "a SemscapeError without a message"
        except Exception as error:  # noqa: BLE001 (this is what is looked for)
            ended = f"{type(error).__name__}: {str(error)[:200]}"
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
    return {
        "number": f"{kind}{number}",
        "maker": maker.__name__,
        "ended": ended,
        "reached": depth.reached(),
        "seconds": seconds,
        "cpu_seconds": cpu,
        "taken_mb": memory.peak_mb() - held_mb,  # what the process held before is not the input's doing
    }


@contextlib.contextmanager
def _alarm() -> Iterator[None]:
    """Let what waits for ever end as a fault."""
    if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def ring(*_: object) -> None:
        raise RuntimeError(f"no end within {_MOST_WAIT_S} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, _MOST_WAIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def is_fault(case: dict[str, Any]) -> bool:
    """Tell whether a case broke the promise; the clock of a machine that does other work too is not its doing."""
    return case["ended"] not in ("good", "refused") or case["cpu_seconds"] > MOST_S or case["taken_mb"] > MOST_MB


def main() -> None:
    """Try them all."""
    from semscape.cluster import Placement, open_executor

    count = int(sys.argv[1]) if len(sys.argv) > 1 else 2000
    cases, faults = [], []
    sys.path.insert(0, str(Path(__file__).parent))
    import hostile  # not __main__'s functions, which a worker cannot find

    with open_executor(Placement(threads=1)) as executor:
        for function, share in ((hostile.try_case, count // 3), (hostile.try_deep_case, count - count // 3)):
            for outcome in executor.run(function, range(share)):
                if outcome.error is not None:
                    told = f"{type(outcome.error).__name__}: {outcome.error}"
                    faults.append({"number": outcome.index, "ended": told, "function": function.__name__})
                else:
                    cases.append(outcome.value)
    faults += [case for case in cases if is_fault(case)]
    series = [case for case in cases if case["maker"] not in ("_manifest", "_options")]
    stages = Counter(case["reached"] for case in series)
    told = {
        "n": count,
        "ended": Counter(case["ended"] if case["ended"] in ("good", "refused") else "fault" for case in cases),
        "manifests_and_options": len(cases) - len(series),
        "reached": {stage: stages[stage] for stage in STAGES},
        "makers": {
            maker: Counter(case["reached"] for case in cases if case["maker"] == maker)
            for maker in sorted({case["maker"] for case in cases})
        },
        "longest_s": round(max(case["seconds"] for case in cases), 2),
        "longest_cpu_s": round(max(case["cpu_seconds"] for case in cases), 2),
        "taken_mb": round(max(case["taken_mb"] for case in cases)),
        "faults": faults,
    }
    print(json.dumps(told, indent=1))
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
