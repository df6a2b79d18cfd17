from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from sem_files import fei_text, noise, write_tiff, zeiss_text

from semscape.io.micrograph import read_micrograph
from semscape.io.thermo_fisher import parse_thermo_fisher
from semscape.io.zeiss import parse_zeiss

FIELDS = (
    "pixel_size_um",
    "tilt_rad",
    "stage_rotation_rad",
    "working_distance_um",
    "accelerating_voltage_kv",
    "magnification",
    "scan_rotation_rad",
)


@pytest.mark.parametrize(
    ("value", "size_um"),
    [
        ("593.3 nm", 0.5933),
        ("2.615 µm", 2.615),
        ("2.615 \u03bcm", 2.615),
        ("2.615 Âµm", 2.615),
        ("2.615 um", 2.615),
        ("7.443e-008 m", 0.07443),
        ("593,3 nm", 0.5933),
        ("900 pm", 0.0009),
    ],
)
def test_zeiss_lengths_carry_their_unit(value: str, size_um: float) -> None:
    metadata, warnings = parse_zeiss(zeiss_text(AP_IMAGE_PIXEL_SIZE=f"Image Pixel Size = {value}"), 1024)
    assert metadata.pixel_size_um == pytest.approx(size_um)
    assert metadata.source["pixel_size_um"] == "file"
    assert warnings == ()


def test_zeiss_display_pixel_size_is_scaled_to_the_stored_image() -> None:
    metadata, _ = parse_zeiss(zeiss_text(AP_PIXEL_SIZE="Pixel Size = 100 nm"), 2048)
    assert metadata.pixel_size_um == pytest.approx(0.05)
    both = zeiss_text(AP_PIXEL_SIZE="Pixel Size = 100 nm", AP_IMAGE_PIXEL_SIZE="Image Pixel Size = 33 nm")
    assert parse_zeiss(both, 2048)[0].pixel_size_um == pytest.approx(0.033)


def test_zeiss_stage_tilt_is_not_the_correction_angle() -> None:
    text = zeiss_text(
        AP_TILT_ANGLE="Tilt Angle =  70.0 °",
        AP_STAGE_AT_T="Stage at T =   2.0 °",
        AP_STAGE_AT_R="Stage at R = 233.5 °",
        DP_TILT_CORRECTION="Tilt Corrn. = Off",
    )
    metadata, _ = parse_zeiss(text, 1024)
    # A positive stage tilt moves peaks up in the image: negative about +x.
    assert np.rad2deg(metadata.tilt_rad) == pytest.approx(-2.0)
    assert np.rad2deg(metadata.stage_rotation_rad) == pytest.approx(233.5)
    assert metadata.tilt_correction_rad is None
    assert np.isnan(metadata.tilt_axis_angle_rad)
    switched_on = parse_zeiss(text.replace("Off", "On"), 1024)[0].tilt_correction_rad
    assert switched_on is not None
    assert np.rad2deg(switched_on) == pytest.approx(70.0)


@pytest.mark.parametrize(("state", "expected_deg"), [("On", 145.6), ("Off", 0.0)])
def test_zeiss_scan_rotation_counts_only_when_on(state: str, expected_deg: float) -> None:
    text = zeiss_text(AP_SCANROTATION="Scan Rotation = 145.6 °", DP_SCAN_ROT=f"Scan Rot = {state}")
    assert np.rad2deg(parse_zeiss(text, 1024)[0].scan_rotation_rad) == pytest.approx(expected_deg)


@pytest.mark.parametrize(("text", "expected"), [("188 X", 188), ("  1.50 K X", 1500), ("150.00 K X", 150_000)])
def test_zeiss_magnification(text: str, expected: float) -> None:
    assert parse_zeiss(zeiss_text(AP_MAG=f"Mag = {text}"), 1024)[0].magnification == pytest.approx(expected)


def test_zeiss_malformed_values_are_unknown_with_a_warning() -> None:
    text = zeiss_text(
        AP_IMAGE_PIXEL_SIZE="Image Pixel Size = ### nm",
        AP_STAGE_AT_T="Stage at T = 1.2.3 °",
        AP_WD="WD = 5.2 parsec",
        AP_MAG="Mag = ",
        AP_ACTUALKV="EHT = 1e999 kV",
        AP_STAGE_AT_R="no equals sign",
    )
    metadata, warnings = parse_zeiss(text, 1024)
    assert all(np.isnan(getattr(metadata, name)) for name in FIELDS)
    assert dict(metadata.source) == {}
    assert len(warnings) == 4
    assert metadata.raw["AP_WD"] == "WD = 5.2 parsec"


def test_zeiss_impossible_pixel_size_is_unknown() -> None:
    for value in ("0 nm", "-5 nm", "3 m"):
        metadata, warnings = parse_zeiss(zeiss_text(AP_IMAGE_PIXEL_SIZE=f"Image Pixel Size = {value}"), 1024)
        assert np.isnan(metadata.pixel_size_um)
        assert len(warnings) == 1


def test_zeiss_cropped_image_is_noted() -> None:
    _, warnings = parse_zeiss(zeiss_text(DP_IMAGE_STORE="Store resolution = 1024 * 768"), 768)
    assert "768 px wide" in warnings[0]


@pytest.mark.parametrize("text", ["", "\0", "AP_WD", "AP_WD\r\nAP_MAG\r\n", "no keys at all", "=\n=\n"])
def test_texts_without_values(text: str) -> None:
    for metadata, warnings in (parse_zeiss(text, 10), parse_thermo_fisher(text, (10, 10))):
        assert all(np.isnan(getattr(metadata, name)) for name in FIELDS)
        assert warnings == ()


def test_fei_units() -> None:
    text = fei_text(
        Beam={"HV": 2000, "Beam": "EBeam", "Scan": "EScan", "ScanRotation": 0.5},
        Scan={"PixelWidth": "2.69792e-007", "PixelHeight": "2.69792e-007"},
        Stage={"StageT": 0.1, "StageR": -0.0123283, "WorkingDistance": 0.00681643},
        Image={"ResolutionX": 1536, "ResolutionY": 1024},
        PrivateFei={"DatabarHeight": 0},
    )
    metadata, warnings = parse_thermo_fisher(text, (1092, 1536))
    assert metadata.pixel_size_um == pytest.approx(0.269792)
    assert metadata.tilt_rad == pytest.approx(-0.1)
    assert metadata.stage_rotation_rad == pytest.approx(-0.0123283)
    assert metadata.working_distance_um == pytest.approx(6816.43)
    assert metadata.accelerating_voltage_kv == pytest.approx(2.0)
    assert metadata.scan_rotation_rad == pytest.approx(0.5)
    assert metadata.tilt_correction_rad is None
    assert metadata.data_bar_rows == 68
    assert metadata.raw["Stage.StageT"] == "0.1"
    assert warnings == ()


@pytest.mark.parametrize(
    ("height", "resolution_y", "databar_height", "expected"),
    [
        (471, 442, 29, 29),
        (1092, 1024, 0, 68),
        (1103, "", 79, 79),
        (1024, 1024, 0, 0),
        (500, 1024, 0, -1),
        (500, "", "", -1),
    ],
)
def test_fei_data_bar(height: int, resolution_y: object, databar_height: object, expected: int) -> None:
    text = fei_text(Image={"ResolutionY": resolution_y}, PrivateFei={"DatabarHeight": databar_height})
    assert parse_thermo_fisher(text, (height, 800))[0].data_bar_rows == expected


def test_fei_tilt_correction_and_beam() -> None:
    beam = {"TiltCorrectionIsOn": "yes", "TiltCorrectionAngle": 0.3, "WD": 0.004}
    metadata, _ = parse_thermo_fisher(fei_text(EBeam=beam), (100, 100))
    assert metadata.tilt_correction_rad == pytest.approx(0.3)
    assert metadata.working_distance_um == pytest.approx(4000)


def test_fei_malformed_values_are_unknown_with_a_warning() -> None:
    text = fei_text(Scan={"PixelWidth": "wide"}, Stage={"StageT": "nan", "StageR": "1e999"}, Beam={"HV": "-5"})
    metadata, warnings = parse_thermo_fisher(text, (100, 100))
    assert all(np.isnan(getattr(metadata, name)) for name in FIELDS)
    assert len(warnings) == 4


def test_fei_oblong_pixels_and_resized_image_are_noted() -> None:
    text = fei_text(Scan={"PixelWidth": 1e-8, "PixelHeight": 1.1e-8}, Image={"ResolutionX": 1536})
    _, warnings = parse_thermo_fisher(text, (100, 768))
    assert len(warnings) == 2


def test_tags_are_read_from_the_file(tmp_path: Path) -> None:
    zeiss = read_micrograph(
        write_tiff(tmp_path / "z.tif", noise(1), zeiss=zeiss_text(AP_STAGE_AT_T="Stage at T = 3 °"))
    )
    assert zeiss.metadata.vendor == "Zeiss"
    assert zeiss.metadata.raw["file.stage_tilt_deg"] == "3"
    image = noise(2, (120, 128))
    fei = read_micrograph(write_tiff(tmp_path / "f.tif", image, fei=fei_text(Image={"ResolutionY": 100})))
    assert fei.metadata.vendor == "Thermo Fisher"
    assert not fei.mask[100:].any()
    assert fei.mask[:100].all()


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "vendor", "has_magnification"),
    [
        ("zeiss_example_sem.tif", "Zeiss", True),
        ("zeiss_merlin_1k.tif", "Zeiss", True),
        ("tfs_example.tif", "Thermo Fisher", False),
        ("fei_helios_8bit.tif", "Thermo Fisher", False),
    ],
)
def test_real_files(shared_data: Path, name: str, vendor: str, has_magnification: bool) -> None:
    folder = shared_data / "vendor_metadata"
    expected = json.loads((folder / "expected.json").read_text())[name]
    micrograph = read_micrograph(folder / name)
    metadata = micrograph.metadata
    assert list(micrograph.image.shape) == expected["shape"]
    assert metadata.vendor == vendor
    assert metadata.pixel_size_um * 1000 == pytest.approx(expected["pixel_nm"], rel=1e-4)
    assert abs(np.rad2deg(metadata.tilt_rad)) == pytest.approx(expected["stage_tilt_deg"], abs=1e-6)
    assert metadata.tilt_rad <= 0
    assert metadata.working_distance_um / 1000 == pytest.approx(expected["wd_mm"], rel=1e-5)
    if has_magnification:
        assert metadata.magnification == expected["mag"]
    assert metadata.scan_rotation_rad == 0.0
    assert metadata.tilt_correction_rad is None
    assert len(metadata.raw) > 100
