"""Thermo Fisher (FEI) metadata: the INI text of TIFF tag 34682, or 34680 in older files.

The traps: `StageT`, `StageR` and `ScanRotation` are in rad, lengths (`PixelWidth`, `WorkingDistance`) in m, `HV`
in V; `DatabarHeight` may be 0 although a bar is burnt in, so the stored height less `ResolutionY` goes first;
`TiltCorrectionAngle` keeps its last value while `TiltCorrectionIsOn` says no; the header states no magnification
that does not depend on the size of a screen, so none is read.

At scan rotation 0 the stage tilts about the image's horizontal axis, and a positive reading turns the surface's
normal towards the top of the image (towards the ion column of a DualBeam; pillars lean upwards). That is assumed
here.
"""

from __future__ import annotations

from semscape.io.metadata_fields import MetadataFields
from semscape.io.quantities import PLAIN, RAD_PER_ANGLE, UM_PER_LENGTH
from semscape.io.vendor_text import ini_values
from semscape.types import SemMetadata

TAGS = (34682, 34680)


def parse_thermo_fisher(
    text: str, image_shape: tuple[int, int], tag: int = TAGS[0]
) -> tuple[SemMetadata, tuple[str, ...]]:
    r"""Return what an FEI text says, and a warning for each value that cannot be read.

    Parameters
    ----------
    text : str
        Content of the tag.
    image_shape : (int, int)
        Height and width of the stored image in px, data bar included.
    tag : int
        34682 or 34680, for the fields' origin.

    Examples
    --------
    >>> metadata, _ = parse_thermo_fisher("[Scan]\r\nPixelWidth=2.69792e-007\r\n", (1092, 1536))
    >>> round(metadata.pixel_size_um, 6), metadata.vendor
    (0.269792, 'Thermo Fisher')
    """
    fields = MetadataFields("Thermo Fisher", ini_values(text), f"tag {tag}")
    beam = fields.text("Beam.Beam") or "EBeam"
    scan = fields.text("Beam.Scan") or "EScan"

    pixel_width, key = fields.read(("Scan.PixelWidth", f"{scan}.PixelWidth"), UM_PER_LENGTH, "m")
    pixel_height, _ = fields.read(("Scan.PixelHeight", f"{scan}.PixelHeight"), UM_PER_LENGTH, "m")
    fields.take_square_pixel(pixel_width, pixel_height, key)
    height, width = image_shape
    fields.warn_if_resized(fields.read("Image.ResolutionX", PLAIN)[0], width)
    fields.take_stage_tilt(("Stage.StageT", f"{beam}.StageTa"), "rad", sign_is_known=True)
    fields.take("stage_rotation_rad", ("Stage.StageR", f"{beam}.StageR"), "rad")
    fields.take("working_distance_um", ("Stage.WorkingDistance", f"{beam}.WD"), "m")
    fields.take("accelerating_voltage_kv", ("Beam.HV", f"{beam}.HV"), "v")
    fields.take("scan_rotation_rad", ("Beam.ScanRotation", f"{beam}.ScanRotation"), "rad")
    if fields.is_on(f"{beam}.TiltCorrectionIsOn"):
        fields.set_tilt_correction(*fields.read(f"{beam}.TiltCorrectionAngle", RAD_PER_ANGLE, "rad"))
        fields.set("tilt_correction_axis_rad", 0.0, f"{beam}.TiltCorrectionIsOn")
    for switch in (f"{beam}.DynamicFocusIsOn", f"{beam}.DynamicWDIsOn"):
        if fields.is_on(switch):
            fields.set_dynamic_focus(switch)
    _take_data_bar(fields, height)
    return fields.metadata(model=fields.text("System.SystemType")), tuple(fields.warnings)


def _take_data_bar(fields: MetadataFields, height: int) -> None:
    stored, key = fields.read("Image.ResolutionY", PLAIN)
    told, told_key = fields.read("PrivateFei.DatabarHeight", PLAIN)
    for rows, origin in ((height - stored, key), (told, told_key)):
        if rows > 0:
            fields.set_data_bar_rows(rows, height, origin)
            return
    if height == stored:
        fields.set_data_bar_rows(0, height, key)
