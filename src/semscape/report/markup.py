"""The report page's smallest parts: tables, pictures and numbers as HTML text."""

from __future__ import annotations

import base64
import hashlib
import io
import math
from collections.abc import Iterable, Sequence
from html import escape

from PIL import Image

from semscape.report.style import STYLE
from semscape.report.wording import number

_WEBP_QUALITY = 84
_VERDICTS = {"good": "good", "usable": "warn", "do not": "bad"}


def page(title: str, sections: Iterable[str], script: str | None = None) -> str:
    """Return a whole page of its sections; it carries its style and script and asks the network for nothing."""
    code = "" if script is None else f"<script>{script}</script>\n"
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        # The browser itself then refuses anything that is not in the file.
        f'<meta http-equiv="Content-Security-Policy" content="{content_policy(script)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(title)}</title>\n<style>\n{STYLE}</style>\n</head>\n"
        "<body>\n<main>\n"
        + "\n".join(section for section in sections if section)
        + f"\n</main>\n{code}</body>\n</html>\n"
    )


def content_policy(script: str | None) -> str:
    """Return the content security policy of a page: what is in it, and of scripts only this very one."""
    allowed = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'"
    if script is None:
        return allowed
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return f"{allowed}; script-src 'sha256-{digest}'"


def figure(png: bytes, title: str, caption: str) -> str:
    """Return a picture with its caption, its bytes inside the page.

    The caption stands above: so those of pictures side by side are level, whatever the pictures' heights.
    """
    return (
        f"<figure><figcaption><b>{escape(title)}.</b> {escape(caption)}</figcaption>"
        f'<img src="{picture_data(_small(png), "webp")}" alt="{escape(title)}"></figure>'
    )


def picture_data(picture: bytes, kind: str = "png") -> str:
    """Return a picture, "png", "jpeg" or "webp", as the address of an image inside the page."""
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode('ascii')}"


def _small(png: bytes) -> bytes:
    """Return a picture as WebP: a fifth of the bytes, which no eye misses."""
    with Image.open(io.BytesIO(png)) as picture:
        stream = io.BytesIO()
        picture.save(stream, "webp", quality=_WEBP_QUALITY, method=4)
    return stream.getvalue()


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table whose first column names its rows; others hold figures, or words where no cell has a digit."""
    rows = [list(row) for row in rows]
    columns = zip(*rows, strict=True)
    kinds = ["" if _are_words(cells) else ' class="num"' for cells in columns] or [' class="num"'] * len(head)
    titles = f"<th>{escape(head[0])}</th>" + "".join(
        f"<th{kind}>{escape(title)}</th>" for title, kind in zip(head[1:], kinds[1:], strict=True)
    )
    body = "".join(
        f'<tr><th scope="row">{escape(row[0])}</th>'
        + "".join(f"<td{kind}>{escape(cell)}</td>" for cell, kind in zip(row[1:], kinds[1:], strict=True))
        + "</tr>"
        for row in rows
    )
    return f'<div class="scroll"><table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table></div>'


def _are_words(cells: Iterable[str]) -> bool:
    text = "".join(cells)
    return any(letter.isalpha() for letter in text) and not any(letter.isdigit() for letter in text)


def verdict_line(verdict: str) -> str:
    """Return a verdict as a paragraph in the colour of its grade."""
    style = next((style for start, style in _VERDICTS.items() if verdict.startswith(start)), "plain")
    return f'<p class="verdict {style}">{escape(plus_minus(verdict))}</p>'


def plus_minus(text: str) -> str:
    """Return a message, written in ASCII, with its proper sign."""
    return text.replace("+-", "±")


def fixed(value: float | None, decimals: int) -> str:
    """Return a number with so many decimals, for columns to be compared down the table."""
    return "–" if value is None else f"{value:,.{decimals}f}"


def percent(fraction: float | None) -> float | None:
    """Return a fraction in percent, None where it is unknown."""
    return None if fraction is None else 100 * fraction


def with_sigma(value: float | None, sigma: float | None) -> str:
    """Return "value ± sigma" with two digits of the sigma.

    Examples
    --------
    >>> with_sigma(-3.02, 0.0229), with_sigma(-0.001, 0.15), with_sigma(20.02, None)
    ('-3.020 ± 0.023', '0.00 ± 0.15', '20.02')
    """
    if value is None or sigma is None or sigma <= 0:
        return number(value, 5)
    decimals = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:z.{decimals}f} ± {sigma:.{decimals}f}"
