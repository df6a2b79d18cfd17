"""No text, however broken, makes a parser crash or yield a value that cannot be."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from semscape.errors import BadInputError
from semscape.io.hitachi import parse_hitachi
from semscape.io.jeol import parse_jeol
from semscape.io.phenom import parse_phenom
from semscape.io.plain_tags import PlainTags, parse_plain_tags
from semscape.io.quantities import KV_PER_VOLTAGE, RAD_PER_ANGLE, UM_PER_LENGTH, parse_quantity
from semscape.io.series_toml import read_series_toml
from semscape.io.tescan import parse_tescan, tescan_tag_text
from semscape.io.thermo_fisher import parse_thermo_fisher
from semscape.io.thermo_fisher_xml import parse_thermo_fisher_xml
from semscape.io.vendor_text import decode_text
from semscape.io.vendors import VENDOR_TAGS, read_vendor_metadata
from semscape.io.zeiss import parse_zeiss
from semscape.types import SemMetadata

Parsed = tuple[SemMetadata, tuple[str, ...]]
SHAPE = (96, 128)
QUICK = settings(max_examples=80, deadline=None)

PARSERS: dict[str, Callable[[str], Parsed]] = {
    "zeiss": lambda text: parse_zeiss(text, SHAPE[1]),
    "thermo_fisher": lambda text: parse_thermo_fisher(text, SHAPE),
    "thermo_fisher_xml": lambda text: parse_thermo_fisher_xml(text, SHAPE),
    "tescan": lambda text: parse_tescan(text, SHAPE),
    "jeol": lambda text: parse_jeol(text, SHAPE),
    "hitachi": lambda text: parse_hitachi(text, SHAPE),
    "phenom": lambda text: parse_phenom(text, SHAPE[0]),
    "plain": lambda text: parse_plain_tags(PlainTags(text, 3.0, 4.0, 10.0)),
}
# Texts whose values are broken rather than their form: {} is where a broken value goes.
FORMS = {
    "zeiss": "AP_WD\nWD = {}\nAP_IMAGE_PIXEL_SIZE\nP = {}\nDP_IMAGE_STORE\nS = {}\nAP_STAGE_AT_T\nT = {}\n"
    "AP_MAG\nM = {}\n",
    "thermo_fisher": "[Scan]\nPixelWidth={}\nPixelHeight={}\n[Stage]\nStageT={}\n[Image]\nResolutionX={}\n"
    "ResolutionY={}\n",
    "thermo_fisher_xml": "<Metadata><Optics><WorkingDistance>{}</WorkingDistance></Optics><BinaryResult><PixelSize>"
    '<X unit="m">{}</X></PixelSize><ImageSize><X>{}</X><Y>{}</Y></ImageSize></BinaryResult></Metadata>',
    "tescan": "[MAIN]\nPixelSizeX={}\nPixelSizeY={}\nImageStripSize={}\n[SEM]\nStageTilt={}\nTiltCorrection={}\n",
    "jeol": "$CM_FIELD_OF_VIEW {}\n$CM_MAG {}\n$$SM_MICRON_BAR {}\n$$SM_MICRON_MARKER {}\n$CM_STAGE_POS {}\n"
    "$CM_FULL_SIZE {}\n",
    "hitachi": "[SemImageFile]\nPixelSize={}\nDataSize={}\nStagePositionT={}\nRasterRotation={}\nTiltCompensation={}\n",
    "old hitachi": "[SemImageFile]\nMagnification={}\nDataSize={}\n",
    "phenom": '<FeiImage><pixelWidth unit="nm">{}</pixelWidth><magnification>{}</magnification>'
    "<databarHeight>{}</databarHeight></FeiImage>",
    "plain": "ImageJ=1\nunit={}\n",
    "ome plain": '<OME><Image><Pixels PhysicalSizeX="{}" PhysicalSizeXUnit="{}" PhysicalSizeY="{}"/></Image></OME>',
}
SERIES_TOML = 'pixel_size_um = {}\ntilts_deg = {}\naxis_deg = {}\n[images."a.tif"]\ndynamic_focus = {}\n'
NUMBERS = st.one_of(
    st.floats().map(repr),
    st.integers().map(str),
    st.sampled_from(["", "-", "1e999", "-0", "0", "nan", "1.2.3", "1,5", "∞", "0x10", "१२", "9" * 400, "1 2 3 4 5 6"]),
    st.text(max_size=20),
)
VALUES = st.tuples(NUMBERS, st.sampled_from(["", " ", " nm", " µm", "pm", " mm", " °", " kV", " K X", " parsec"])).map(
    "".join
)


def check(parsed: Parsed) -> None:
    metadata, warnings = parsed
    assert all(isinstance(text, str) and text for text in warnings)
    assert set(metadata.origin) <= set(metadata.source)
    for name in ("pixel_size_um", "working_distance_um", "accelerating_voltage_kv", "magnification"):
        value = getattr(metadata, name)
        assert math.isnan(value) or 0 < value < math.inf
        assert (name in metadata.source) == (not math.isnan(value))
    for name in ("tilt_rad", "stage_rotation_rad", "scan_rotation_rad"):
        assert not math.isinf(getattr(metadata, name))
    assert -1 <= metadata.data_bar_rows < SHAPE[0]


@pytest.mark.parametrize("name", PARSERS)
def test_any_text(name: str) -> None:
    @QUICK
    @given(st.text())
    @example("")
    @example("\0")
    @example("<")
    @example("[" * 500)
    @example("<a>" * 300)
    def run(text: str) -> None:
        check(PARSERS[name](text))

    run()


@pytest.mark.parametrize("name", FORMS)
def test_any_value(name: str) -> None:
    count = FORMS[name].count("{}")

    @QUICK
    @given(st.lists(VALUES, min_size=count, max_size=count))
    def run(values: list[str]) -> None:
        check(PARSERS[name.split()[-1]](FORMS[name].format(*values)))

    run()


@QUICK
@given(st.binary())
def test_any_bytes(data: bytes) -> None:
    assert isinstance(decode_text(data), str)
    check(parse_tescan(tescan_tag_text(data), SHAPE))


@QUICK
@given(st.sampled_from(VENDOR_TAGS), st.binary(), st.sampled_from([".txt", ".hdr"]), st.binary())
@example(VENDOR_TAGS[0], b"", ".txt", "[SemImageFile]\nPixelSize=1".encode("utf-16")[:-1])
def test_any_bytes_of_tags_and_sidecars(tag: int, data: bytes, suffix: str, sidecar: bytes) -> None:
    with TemporaryDirectory() as folder:
        (Path(folder) / f"a{suffix}").write_bytes(sidecar)
        metadata, warnings = read_vendor_metadata(Path(folder) / "a.tif", {tag: data}, PlainTags(), SHAPE)
    check((metadata, warnings))
    assert metadata.raw or warnings  # what is dropped is said


@QUICK
@given(st.one_of(st.text(), st.lists(VALUES, min_size=4, max_size=4).map(lambda v: SERIES_TOML.format(*v))))
@example(SERIES_TOML.format("1", "[1, 2]", "90.0", '"on"'))
def test_any_series_toml(text: str) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "series.toml"
        path.write_bytes(text.encode("utf-8", errors="surrogatepass"))
        try:
            told = read_series_toml(path, ["a.tif", "b.tif"])
        except BadInputError:
            return
    assert all(not math.isnan(value) for fields in told.fields.values() for value in fields.values())


@QUICK
@given(st.floats(1e-12, 1e12), st.sampled_from(["pm", "nm", "µm", "um", "mm", "m"]))
def test_lengths_round_trip(value: float, unit: str) -> None:
    assert parse_quantity(f"{value!r} {unit}", UM_PER_LENGTH) == pytest.approx(value * UM_PER_LENGTH[unit])


@QUICK
@given(VALUES, st.sampled_from([UM_PER_LENGTH, RAD_PER_ANGLE, KV_PER_VOLTAGE]))
def test_a_quantity_is_finite_or_refused(text: str, units: dict[str, float]) -> None:
    try:
        value = parse_quantity(text, units)
    except ValueError:
        return
    assert math.isfinite(value)
