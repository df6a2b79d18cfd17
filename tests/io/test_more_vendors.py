"""TESCAN, JEOL, Hitachi, Phenom, Thermo Fisher's XML, and files that no microscope wrote.

Of Phenom, Thermo Fisher's XML and old Hitachi microscopes no real file is at hand: theirs are generated here, with
the keys that public descriptions and programs that read them (Bio-Formats, pynxtools-em, SEMParser) agree on.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image
from sem_files import fei_text, noise, write_image, write_tiff, zeiss_text

from semscape.io.hitachi import parse_hitachi
from semscape.io.jeol import parse_jeol
from semscape.io.micrograph import read_micrograph, read_micrograph_and_warnings
from semscape.io.phenom import parse_phenom
from semscape.io.series import load_series
from semscape.io.tescan import parse_tescan, tescan_tag_text
from semscape.io.thermo_fisher_xml import parse_thermo_fisher_xml
from semscape.io.vendor_text import decode_text

SHAPE = (960, 1280)


def tescan_block(kind: int, content: bytes) -> bytes:
    return (2 + len(content)).to_bytes(4, "little") + kind.to_bytes(2, "little") + content


TESCAN_MAIN = (
    b"Device=MIRA3 XMU\r\nImageStripSize=20\r\nMagnification=108.08\r\nPixelSizeX=2.5e-9\r\nPixelSizeY=2.5e-9\r\n\0"
)
TESCAN_SEM = (
    b"HV=10.0e3\r\nScanRotation=0.0\r\nStageRotation=30.0\r\nStageTilt=5.0\r\nTiltCorrection=0.0\r\nWD=13.25e-3\r\n\0"
)
TESCAN_TAG = (
    tescan_block(1, b"\0\0\0\x0cjP  PixelSizeX=9\r\n\xff\xd9")
    + tescan_block(2, TESCAN_MAIN)
    + tescan_block(3, TESCAN_SEM)
    + tescan_block(0, b"")
)


def test_tescan_tag_after_its_thumbnail(tmp_path: Path) -> None:
    image = noise(1, (120, 128))
    path = tmp_path / "t.tif"
    tifffile.imwrite(path, image, extratags=[(50431, "B", len(TESCAN_TAG), TESCAN_TAG, True)], metadata=None)
    micrograph, warnings = read_micrograph_and_warnings(path)
    metadata = micrograph.metadata
    assert (metadata.vendor, metadata.model) == ("TESCAN", "MIRA3 XMU")
    assert metadata.pixel_size_um == pytest.approx(0.0025)
    assert metadata.origin["pixel_size_um"] == "tag 50431, PixelSizeX"
    assert metadata.working_distance_um == pytest.approx(13250)
    assert metadata.accelerating_voltage_kv == pytest.approx(10)
    assert metadata.magnification == pytest.approx(108.08)
    assert np.rad2deg(metadata.stage_rotation_rad) == pytest.approx(30)
    assert np.rad2deg(metadata.tilt_rad) == pytest.approx(-5)
    assert metadata.tilt_correction_rad is None
    assert not micrograph.mask[100:].any()
    assert micrograph.mask[:100].all()
    assert len(warnings) == 1
    assert "sign of this TESCAN stage's tilt is assumed" in warnings[0]


def test_tescan_tag_in_unknown_blocks_and_correction() -> None:
    text = tescan_tag_text(b"???\xff\xd8thumbnail\xff\xd9" + TESCAN_MAIN + TESCAN_SEM)
    assert parse_tescan(text, (120, 128))[0].pixel_size_um == pytest.approx(0.0025)
    on = parse_tescan("TiltCorrection=45.0\r\nPixelSizeX=2e-9\r\nPixelSizeY=3e-9\r\n", (120, 128))
    assert on[0].tilt_correction_rad == pytest.approx(math.pi / 4)
    assert "0.002 um wide but 0.003 um high" in on[1][0]


@pytest.mark.parametrize("name", ["a-tif.hdr", "a.hdr", "A.HDR"])
def test_tescan_sidecar(tmp_path: Path, name: str) -> None:
    path = write_tiff(tmp_path / "a.tif", noise(1))
    (tmp_path / name).write_text("[MAIN]\nDevice=TESCAN SOLARIS X\nPixelSizeX=0.00000005\nPixelSizeY=5e-8\n")
    metadata = read_micrograph(path).metadata
    assert metadata.pixel_size_um == pytest.approx(0.05)
    assert metadata.origin["pixel_size_um"] == f"{name}, MAIN.PixelSizeX"


@pytest.mark.parametrize(
    ("lines", "size_um"),
    [
        ("$$SM_MICRON_BAR 160\n$$SM_MICRON_MARKER 8um\n$CM_FIELD_OF_VIEW 1000 750\n$CM_MAG 50\n", 0.05),
        ("$$SM_MICRON_BAR 160\n$$SM_MICRON_MARKER 800nm\n", 0.005),
        ("$CM_FIELD_OF_VIEW 128.0 96.0\n$CM_MAG 50\n", 0.1),
        ("$CM_FIELD_OF_VIEW 128.0µm 96.0µm\n", 0.1),
        ("$CM_FIELD_OF_VIEW 128.0 µm 96.0 µm\n", 0.1),
        ("$CM_MAG 50\n$CM_FULL_SIZE 1280 960\n", 2.0),
        ("$SM_MICRON_BAR 0\n$$SM_MICRON_MARKER 8um\n", math.nan),
    ],
)
def test_jeol_pixel_size(lines: str, size_um: float) -> None:
    assert parse_jeol(lines, SHAPE)[0].pixel_size_um == pytest.approx(size_um, nan_ok=True)


def test_jeol_stage_is_read_only_where_its_order_does_not_matter() -> None:
    level, _ = parse_jeol("$CM_STAGE_POS 5.483 0.831 8.5 -0.0 0.0 0.000\n$$SM_WD 9.07\n$CM_ACCEL_VOLT 5.00\n", SHAPE)
    assert (level.tilt_rad, level.stage_rotation_rad) == (0.0, 0.0)
    assert (level.working_distance_um, level.accelerating_voltage_kv) == (pytest.approx(9070), 5.0)
    tilted, warnings = parse_jeol("$CM_STAGE_POS 5.483 0.831 8.5 0.0 5.0 0.000\n", SHAPE)
    assert math.isnan(tilted.tilt_rad)
    assert "0 and 5 deg" in warnings[0]


@pytest.mark.parametrize("position", ["0.0 {}", "{} 30.0"])
def test_a_jeol_series_shows_which_angle_is_the_tilt(tmp_path: Path, position: str) -> None:
    for i in range(3):
        write_tiff(tmp_path / f"a{i}.tif", noise(i))
        (tmp_path / f"a{i}.txt").write_text(f"$CM_STAGE_POS 1 2 3 {position.format(5 * i)} 0.000\n")
    series = load_series(tmp_path)
    np.testing.assert_allclose(np.rad2deg(series.tilt_rad), [-10, -5, 0])
    assert any("only one changes, from 0 to 10 deg" in text for text in series.warnings)
    for i in range(3):
        (tmp_path / f"a{i}.txt").write_text(f"$CM_STAGE_POS 1 2 3 {5 * i} {i} 0.000\n")
    assert np.isnan(load_series(tmp_path).tilt_rad).tolist() == [False, True, True]  # the first is level


def test_jeol_bar_of_newer_microscopes() -> None:
    text = "$CM_IMAGE_SIZE 1280 960\n$$SM_PNU_HEIGHT 64\n"
    assert parse_jeol(text, (1024, 1280))[0].data_bar_rows == 64
    assert parse_jeol(text, (960, 1280))[0].data_bar_rows == -1


HITACHI = (
    "[SemImageFile]\r\nInstructName={}\r\nDataSize=1280x960\r\nPixelSize=165.3646\r\nAcceleratingVoltage=15000 Volt\r\n"
    "Magnification=600\r\nWorkingDistance=7892.3 um\r\nStagePositionT=5.000\r\nDynamicFocus=1\r\nTiltCompensation=0\r\n"
    "RasterRotation=10.2\r\n"
)


@pytest.mark.parametrize(("model", "encoding"), [("TM4000", "utf-16"), ("TM4000", "utf-16-le"), ("S-4800", "ascii")])
def test_hitachi_sidecar(tmp_path: Path, model: str, encoding: str) -> None:
    path = write_tiff(tmp_path / "a.tif", noise(1, (96, 1280)))
    (tmp_path / "a.txt").write_bytes(HITACHI.format(model).encode(encoding))
    micrograph, warnings = read_micrograph_and_warnings(path)
    metadata = micrograph.metadata
    assert (metadata.vendor, metadata.model) == ("Hitachi", model)
    assert metadata.pixel_size_um == pytest.approx(0.1653646)
    assert metadata.working_distance_um == pytest.approx(7892.3)
    assert metadata.accelerating_voltage_kv == pytest.approx(15)
    assert np.rad2deg(metadata.tilt_rad) == pytest.approx(-5)
    assert metadata.dynamic_focus
    assert metadata.tilt_correction_rad is None
    assert math.isnan(metadata.scan_rotation_rad)
    assert any("10.2 deg, but is stored even when it is off" in text for text in warnings)


def hitachi_bytes() -> bytes:
    return HITACHI.format("TM4000").encode("utf-16")


@pytest.mark.parametrize(
    ("content", "known"),
    [
        (hitachi_bytes()[:1] + hitachi_bytes()[2:], False),  # the mark lost a byte: nothing can be read
        (b"\xff\xfe" + hitachi_bytes()[3:], False),
        (hitachi_bytes()[:200] + hitachi_bytes()[201:], True),  # a byte is lost within: the beginning can be read
        (hitachi_bytes()[:201], True),
        (b"", False),
        ("[SemImage]\nPixelSize=5\n".encode("utf-16"), False),  # the section is missing
    ],
)
def test_a_damaged_sidecar_is_said(tmp_path: Path, content: bytes, known: bool) -> None:
    path = write_tiff(tmp_path / "a.tif", noise(1, (96, 1280)))
    (tmp_path / "a.txt").write_bytes(content)
    micrograph, warnings = read_micrograph_and_warnings(path)
    assert any(".txt file beside the image" in text for text in warnings)
    assert (micrograph.metadata.vendor == "Hitachi") == known
    assert math.isnan(micrograph.metadata.tilt_rad)
    assert math.isnan(micrograph.metadata.working_distance_um)


def test_a_tag_that_holds_nothing_is_said(tmp_path: Path) -> None:
    path = write_tiff(tmp_path / "a.tif", noise(1), fei="no section and no value")
    micrograph, warnings = read_micrograph_and_warnings(path)
    assert "tag 34682 holds nothing that can be read" in warnings[0]
    assert math.isnan(micrograph.metadata.pixel_size_um)


OLD_HITACHI = """[SemImageFile]
InstructName=S-4700
SerialNumber=0000-00
Format=tif
ImageName=a.tif
Date=06/06/2008
DataSize=1280x960
AcceleratingVoltage=10000 Volt
Magnification=15000
WorkingDistance=8100 um
LensMode=High
MicronMarker=3000
Condition=Vacc=10kV   Mag=x15.0k   WD=8.1mm
"""


def test_old_hitachi_text_without_a_pixel_size(tmp_path: Path) -> None:
    """127 mm is the width of the photograph: a measured TM4000 (below) has 165.3646 nm x 1280 x 600 = 127.00 mm."""
    path = write_tiff(tmp_path / "a.tif", noise(1, (96, 1280)))
    (tmp_path / "a.txt").write_text(OLD_HITACHI, encoding="ascii")
    micrograph, warnings = read_micrograph_and_warnings(path)
    metadata = micrograph.metadata
    assert (metadata.vendor, metadata.model) == ("Hitachi", "S-4700")
    assert metadata.pixel_size_um == pytest.approx(0.00661458, rel=1e-5)
    assert metadata.origin["pixel_size_um"] == "a.txt, 127 mm / SemImageFile.Magnification / width"
    assert metadata.working_distance_um == pytest.approx(8100)
    assert metadata.accelerating_voltage_kv == pytest.approx(10)
    assert "check the scale bar" in warnings[0]
    told, _ = parse_hitachi(HITACHI, SHAPE)
    assert told.pixel_size_um * told.magnification * 1280 == pytest.approx(127e3, rel=1e-5)
    broken, warnings = parse_hitachi(OLD_HITACHI + "PixelSize=###\n", SHAPE)
    assert math.isnan(broken.pixel_size_um)  # a value that cannot be read is not replaced by a guess
    assert "###" in warnings[0]


@pytest.mark.parametrize("switch", ["1", "5.5", "On"])
def test_hitachi_tilt_compensation_of_unknown_angle(switch: str) -> None:
    metadata, warnings = parse_hitachi(f"[SemImageFile]\nTiltCompensation={switch}\nRasterRotation=0\n", SHAPE)
    assert not warnings
    assert metadata.tilt_correction_rad is not None
    assert math.isnan(metadata.tilt_correction_rad)
    assert metadata.scan_rotation_rad == 0.0


def test_nothing_is_taken_from_other_texts_beside_an_image(tmp_path: Path) -> None:
    path = write_tiff(tmp_path / "a.tif", noise(1))
    (tmp_path / "a.txt").write_text("PixelSize=5\nnotes of the day")
    (tmp_path / "a.hdr").write_bytes(bytes(range(256)))
    micrograph, warnings = read_micrograph_and_warnings(path)
    assert warnings == (
        "a.tif: nothing is taken from the .txt file beside the image: neither JEOL's nor Hitachi's nor TESCAN's",
        "a.tif: nothing is taken from the .hdr file beside the image: its text is not whole",
    )
    assert dict(micrograph.metadata.source) == {}


FEI_XML = """<?xml version="1.0"?>
<Metadata xmlns:nil="http://schemas.fei.com/Metadata/v1/2013/07">
 <Instrument><InstrumentClass>Helios 5</InstrumentClass></Instrument>
 <Optics><AccelerationVoltage>2000</AccelerationVoltage><WorkingDistance>0.0038</WorkingDistance>
  <SampleTiltCorrectionOn>{on}</SampleTiltCorrectionOn><SamplePreTiltAngle>{pre}</SamplePreTiltAngle></Optics>
 <StageSettings><StagePosition><Rotation>-3.1</Rotation><Tilt><Alpha>0.4712</Alpha></Tilt></StagePosition></StageSettings>
 <ScanSettings><ScanRotation>3.1415926535897931</ScanRotation></ScanSettings>
 <BinaryResult><ImageSize><X>128</X><Y>100</Y></ImageSize>
  <PixelSize><X unit="m" unitPrefixPower="{power}">2.7E-07</X><Y unit="m" unitPrefixPower="1">2.7E-07</Y></PixelSize>
 </BinaryResult>
</Metadata>"""


def test_fei_xml() -> None:
    metadata, warnings = parse_thermo_fisher_xml(FEI_XML.format(on="false", pre="-0.66", power="1"), (120, 128))
    assert warnings == ()
    assert metadata.model == "Helios 5"
    assert metadata.pixel_size_um == pytest.approx(0.27)
    assert metadata.tilt_rad == pytest.approx(-0.4712)
    assert metadata.scan_rotation_rad == pytest.approx(math.pi)
    assert metadata.working_distance_um == pytest.approx(3800)
    assert metadata.accelerating_voltage_kv == pytest.approx(2)
    assert metadata.data_bar_rows == 20
    assert metadata.tilt_correction_rad is None
    assert metadata.raw["Metadata.BinaryResult.PixelSize.X@unit"] == "m"
    on, _ = parse_thermo_fisher_xml(FEI_XML.format(on="true", pre="0", power="1"), (120, 128))
    assert on.tilt_correction_rad == pytest.approx(0.4712)
    pre_tilted, _ = parse_thermo_fisher_xml(FEI_XML.format(on="true", pre="-0.66", power="1"), (120, 128))
    assert math.isnan(pre_tilted.tilt_correction_rad or 0.0)
    strange, warnings = parse_thermo_fisher_xml(FEI_XML.format(on="false", pre="0", power="-9"), (120, 128))
    assert math.isnan(strange.pixel_size_um)
    assert "unit prefix power" in warnings[0]


def test_a_series_whose_files_hold_fei_xml_alone(tmp_path: Path) -> None:
    """Scanned upside down, as the file's own 180 deg say: the tilts' sign is turned."""
    for i in range(3):
        text = FEI_XML.format(on="false", pre="0", power="1").replace("0.4712", str(0.1 * i))
        tags = [(34683, "s", 0, text.encode(), True)]
        tifffile.imwrite(tmp_path / f"a{i}.tif", noise(i, (120, 128)), extratags=tags, metadata=None)
    series = load_series(tmp_path)
    np.testing.assert_allclose(series.tilt_rad, [0.0, 0.1, 0.2])
    np.testing.assert_allclose(series.pixel_size_um, 0.27)
    assert not series.views[0].mask[100:].any()
    assert any("tag 34683, Metadata.ScanSettings.ScanRotation" in text for text in series.warnings)


def test_fei_ini_goes_before_its_xml_which_completes_it(tmp_path: Path) -> None:
    ini = fei_text(Scan={"PixelWidth": 1e-8, "PixelHeight": 1e-8})
    path = tmp_path / "a.tif"
    tags = [
        (code, "s", 0, text.encode(), True)
        for code, text in ((34682, ini), (34683, FEI_XML.format(on="false", pre="0", power="1")))
    ]
    tifffile.imwrite(path, noise(1, (120, 128)), extratags=tags, metadata=None)
    metadata = read_micrograph(path).metadata
    assert metadata.pixel_size_um == pytest.approx(0.01)
    assert metadata.tilt_rad == pytest.approx(-0.4712)
    assert (metadata.origin["pixel_size_um"][:9], metadata.origin["tilt_rad"][:9]) == ("tag 34682", "tag 34683")


PHENOM_XML = """<FeiImage version="2.0"><databarHeight>24</databarHeight><databarFields>0</databarFields>
<pixelWidth unit="nm">52.1</pixelWidth><pixelHeight unit="nm">52.1</pixelHeight>
<instrument><type>DP-8</type><edition>G4 Phenom ProX</edition></instrument>
<workingDistance unit="mm">6.1</workingDistance>
<acquisition><scan><highVoltage unit="kV">-10</highVoltage></scan></acquisition>
<multiStage><axis id="X" unit="um">3</axis><axis id="Tilt" unit="deg">7</axis></multiStage></FeiImage>"""


def test_phenom(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, noise(1), extratags=[(34683, "s", 0, PHENOM_XML.encode(), True)], metadata=None)
    micrograph = read_micrograph(path)
    assert micrograph.mask[:72].all()
    assert not micrograph.mask[72:].any()
    metadata = micrograph.metadata
    assert (metadata.vendor, metadata.model) == ("Phenom", "G4 Phenom ProX")
    assert metadata.pixel_size_um == pytest.approx(0.0521)
    assert metadata.working_distance_um == pytest.approx(6100)
    assert metadata.accelerating_voltage_kv == pytest.approx(10)
    assert np.rad2deg(metadata.tilt_rad) == pytest.approx(-7)
    unknown, warnings = parse_phenom("<FeiImage><pixelWidth>52</pixelWidth></FeiImage>", 96)
    assert math.isnan(unknown.pixel_size_um)
    assert "no unit" in warnings[0]


def test_phenom_jpeg_holds_the_same_in_its_exif(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[34683] = PHENOM_XML
    metadata = read_micrograph(write_image(tmp_path / "a.jpg", noise(1), exif=exif)).metadata
    assert metadata.pixel_size_um == pytest.approx(0.0521)
    assert metadata.data_bar_rows == 24
    assert metadata.origin["pixel_size_um"] == "tag 34683, FeiImage.pixelWidth"


def test_entities_of_xml_are_not_expanded() -> None:
    bomb = '<!DOCTYPE a [<!ENTITY b "bbbb">]><FeiImage><pixelWidth unit="nm">&b;</pixelWidth></FeiImage>'
    assert parse_phenom(bomb, 96)[0].raw == {}


@pytest.mark.parametrize(("unit", "size_um"), [("um", 0.05), ("micron", 0.05), ("\\u00B5m", 0.05), ("nm", 5e-5)])
def test_imagej(tmp_path: Path, unit: str, size_um: float) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, noise(1), imagej=True, resolution=(20.0, 20.0), metadata={"unit": unit})
    metadata = read_micrograph(path).metadata
    assert metadata.pixel_size_um == pytest.approx(size_um)
    assert metadata.source["pixel_size_um"] == "file"
    assert metadata.vendor == "unknown"


def test_ome(tmp_path: Path) -> None:
    path = tmp_path / "a.ome.tif"
    sizes = {"PhysicalSizeX": 50.0, "PhysicalSizeXUnit": "nm", "PhysicalSizeY": 50.0, "PhysicalSizeYUnit": "nm"}
    tifffile.imwrite(path, noise(1), ome=True, metadata={"axes": "YX", **sizes})
    metadata = read_micrograph(path).metadata
    assert metadata.pixel_size_um == pytest.approx(0.05)
    assert metadata.origin["pixel_size_um"] == "OME description, OME.Image.Pixels@PhysicalSizeX"


def test_bare_resolution_is_doubtful_and_that_of_a_screen_is_none(tmp_path: Path) -> None:
    fine, screen = tmp_path / "fine.tif", tmp_path / "screen.tif"
    tifffile.imwrite(fine, noise(1), resolution=(200_000, 200_000), resolutionunit="CENTIMETER", metadata=None)
    tifffile.imwrite(screen, noise(1), resolution=(300, 300), resolutionunit="INCH", metadata=None)
    micrograph, warnings = read_micrograph_and_warnings(fine)
    assert micrograph.metadata.pixel_size_um == pytest.approx(0.05)
    assert micrograph.metadata.source["pixel_size_um"] == "doubtful"
    assert "doubtful" in warnings[0]
    micrograph, warnings = read_micrograph_and_warnings(screen)
    assert math.isnan(micrograph.metadata.pixel_size_um)
    assert warnings == ()


def test_exif_comes_last_and_is_doubtful(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[282], exif[283], exif[296] = 508_000.0, 508_000.0, 2
    path = write_image(tmp_path / "a.jpg", noise(1), exif=exif, dpi=(508_000, 508_000))
    metadata = read_micrograph(path).metadata
    if math.isfinite(metadata.pixel_size_um):  # JFIF holds densities up to 65535 only
        assert metadata.source["pixel_size_um"] == "doubtful"
    exif[34118] = zeiss_text(AP_IMAGE_PIXEL_SIZE="Image Pixel Size = 74.43 nm")
    metadata = read_micrograph(write_image(tmp_path / "b.jpg", noise(1), exif=exif)).metadata
    assert metadata.pixel_size_um == pytest.approx(0.07443)
    assert metadata.origin["pixel_size_um"] == "tag 34118, AP_IMAGE_PIXEL_SIZE"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
def test_encodings(encoding: str) -> None:
    assert decode_text("PixelSize = 2.615 µm, a longer text".encode(encoding)) == "PixelSize = 2.615 µm, a longer text"


VENDORS = {
    "Zeiss": "Zeiss",
    "FEI/TFS Scios": "Thermo Fisher Scios",
    "FEI Helios 660": 'Thermo Fisher Helios NanoLab" 660',
    "TESCAN MIRA3": "TESCAN MIRA3 XMU",
    "TESCAN SOLARIS X": "TESCAN TESCAN SOLARIS X",
    "Hitachi TM4000": "Hitachi TM4000",
    "JEOL 4700F": "JEOL 4700F",
}


@pytest.mark.real_data
def test_all_answers_about_the_vendors_files(shared_data: Path) -> None:
    folder = shared_data / "vendor_metadata"
    answers = json.loads((folder / "expected.json").read_text())
    assert len(answers) == 8
    for name, expected in answers.items():
        if name.endswith(".hdr"):
            metadata = parse_tescan((folder / name).read_text(), (768, 1024), name)[0]
            shape = expected.get("shape")
        else:
            micrograph = read_micrograph(folder / name)
            metadata, shape = micrograph.metadata, list(micrograph.image.shape)
        found = {
            "vendor": expected["vendor"],
            "pixel_nm": metadata.pixel_size_um * 1000,
            "stage_tilt_deg": -math.degrees(metadata.tilt_rad),
            "stage_rot_deg": math.degrees(metadata.stage_rotation_rad),
            "wd_mm": metadata.working_distance_um / 1000,
            "mag": metadata.magnification,
            "shape": shape,
            "hfw_um": metadata.pixel_size_um * (shape or [0, 0])[1],
            "image_strip_rows": metadata.data_bar_rows,
            "stage_pos": metadata.raw.get("$CM_STAGE_POS"),
            "pixel_rule": expected.get("pixel_rule"),
        }
        assert VENDORS[expected["vendor"]] in f"{metadata.vendor} {metadata.model}", name
        for key, value in expected.items():
            if isinstance(value, float):
                assert found[key] == pytest.approx(value, rel=1e-4, abs=1e-6), (name, key)
            else:
                assert found[key] == value, (name, key)
        known = {key for key in metadata.source if key not in ("stage_rotation_rad",)}
        assert known <= set(metadata.origin), name
