"""The containers in which vendors keep their values: bytes in some encoding, INI texts, XML trees."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

# More than any microscope writes; a longer text is no header.
MAX_TEXT_BYTES = 8_000_000
_MAX_XML_ITEMS = 100_000
_FEW_SHIFTED = 3


def decode_text(value: Any) -> str:
    r"""Return the text of a tag or sidecar: UTF-16 or UTF-8 where it is that, else Windows-1252.

    SmartSEM and xT write Windows-1252, some editors rewrite it as UTF-8; Hitachi writes UTF-16 or plain ASCII.

    Examples
    --------
    >>> decode_text("PixelSize=5".encode("utf-16")), decode_text(b"WD = 5 \xb5m")
    ('PixelSize=5', 'WD = 5 µm')
    """
    if isinstance(value, str):
        return value.rstrip("\0")
    data = bytes(value)[:MAX_TEXT_BYTES]
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace").rstrip("\0")
    # Without a mark, UTF-16 of Western text shows by a zero in every other byte.
    for encoding, zeros in (("utf-16-le", data[1:200:2]), ("utf-16-be", data[0:200:2])):
        if len(zeros) >= 4 and zeros.count(0) > 0.8 * len(zeros):
            return data.decode(encoding, errors="replace").rstrip("\0")
    try:
        return data.decode("utf-8-sig").rstrip("\0")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace").rstrip("\0")


def is_broken(text: str) -> bool:
    r"""Tell whether a decoded text holds what its encoding cannot: replaced bytes, or UTF-16 that lost a byte.

    Behind a lost byte every letter of Western text has its byte in the upper half.

    Examples
    --------
    >>> whole = "PixelSize=5 nm".encode("utf-16")
    >>> is_broken(decode_text(whole)), is_broken(decode_text(whole[:9] + whole[10:]))
    (False, True)
    """
    shifted = sum(1 for letter in text if not ord(letter) & 0xFF and 0x20 <= ord(letter) >> 8 < 0x7F)
    return "\ufffd" in text or shifted > max(_FEW_SHIFTED, 0.02 * len(text))


def ini_values(text: str) -> dict[str, str]:
    r"""Return {"Section.Key": value} of an INI text, the first of a key that comes twice.

    Keys above the first section stand alone.

    Examples
    --------
    >>> ini_values("[Scan]\r\nPixelWidth=2.7e-007\r\n")
    {'Scan.PixelWidth': '2.7e-007'}
    """
    raw: dict[str, str] = {}
    section = ""
    for line in text.replace("\0", "").splitlines():
        stripped = line.strip()
        if stripped.startswith("[") and stripped.endswith("]"):
            section = stripped[1:-1].strip()
            continue
        key, equals, value = stripped.partition("=")
        if equals and key.strip():
            raw.setdefault(f"{section}.{key.strip()}" if section else key.strip(), value.strip())
    return raw


def xml_values(text: str) -> dict[str, str]:
    """Return {"Root.Child.Leaf": text, "Root.Child@attribute": value} of an XML text; {} where it is none.

    Names lose their namespace; the second of equal paths becomes `Path#2`. Texts that declare entities are not
    read: they can grow without bound.

    Examples
    --------
    >>> xml_values('<a><b unit="m">1</b><b>2</b></a>')
    {'a.b@unit': 'm', 'a.b': '1', 'a.b#2': '2'}
    """
    import xml.etree.ElementTree as ElementTree

    start = text.find("<")
    if start < 0 or "<!ENTITY" in text or "<!DOCTYPE" in text:
        return {}
    parser: ElementTree.XMLPullParser[Any] = ElementTree.XMLPullParser(events=("start", "end"))
    raw: dict[str, str] = {}
    counts: dict[str, int] = {}
    path: list[str] = []
    try:
        parser.feed(text[start : text.rfind(">") + 1])
        for event, element in cast("Iterator[tuple[str, Element]]", parser.read_events()):
            if event == "start":
                name = str(element.tag).rpartition("}")[2]
                full = ".".join((*path[-1:], name))
                counts[full] = counts.get(full, 0) + 1
                full += f"#{counts[full]}" if counts[full] > 1 else ""
                path.append(full)
                for key, value in element.attrib.items():
                    raw[f"{full}@{key.rpartition('}')[2]}"] = value.strip()
            else:
                value = (element.text or "").strip()
                if value and len(element) == 0:
                    raw[path[-1]] = value
                path.pop()
            if len(raw) > _MAX_XML_ITEMS or len(path) > 100:
                return {}
    except ElementTree.ParseError:
        return {}
    return raw if not path else {}
