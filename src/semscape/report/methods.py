"""Which methods a run used, each with its paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

Method = tuple[str, str, str, str]
"""Stage, what was done, authors and year, DOI ("" where the paper has none)."""

_DETECTORS = {
    "sift": ("SIFT keypoints", "Lowe 2004", "10.1023/B:VISI.0000029664.99615.94"),
    "surf": ("SURF keypoints", "Bay et al. 2008", "10.1016/j.cviu.2007.09.014"),
    "orb": ("ORB keypoints", "Rublee et al. 2011", "10.1109/ICCV.2011.6126544"),
    "brief": ("BRIEF on STAR keypoints", "Calonder et al. 2010", "10.1007/978-3-642-15561-1_56"),
}


def methods(options: Mapping[str, Mapping[str, Any]]) -> tuple[Method, ...]:
    """Return the methods that a run with these options uses, in the order of its stages.

    Examples
    --------
    >>> [paper for _, _, paper, _ in methods({})][:2]
    ['Lowe 2004', 'Arandjelović & Zisserman 2012']
    """
    features, sfm, dense = (options.get(stage, {}) for stage in ("features", "sfm", "dense"))
    detector = features.get("detector", "sift")
    found: list[Method] = []
    if detector in _DETECTORS:
        found.append(("Keypoints", *_DETECTORS[detector]))
    if detector == "sift":
        found.append(("Matching", "RootSIFT", "Arandjelović & Zisserman 2012", "10.1109/CVPR.2012.6248018"))
    found += [
        ("Matching", "a contrario inliers", "Moisan & Stival 2004", "10.1023/B:VISI.0000013094.38752.54"),
        ("Matching", "a contrario RANSAC", "Moulon et al. 2012", "10.1007/978-3-642-37447-0_20"),
        ("Matching", "epipolar geometry of parallel projection", "Shapiro et al. 1995", "10.1007/BF01539553"),
        ("Calibration", "relief from parallel projections", "Koenderink & van Doorn 1991", "10.1364/JOSAA.8.000377"),
        ("Calibration", "variable projection", "Golub & Pereyra 1973", "10.1137/0710036"),
        ("Calibration", "Differential Evolution", "Storn & Price 1997", "10.1023/A:1008202821328"),
        ("Calibration", "bundle adjustment", "Triggs et al. 2000", "10.1007/3-540-44480-7_21"),
        ("Calibration", "robust weights", "Holland & Welsch 1977", "10.1080/03610927708827533"),
        ("Surface", "census transform", "Zabih & Woodfill 1994", "10.1007/BFb0028345"),
        ("Surface", "semi-global matching", "Hirschmüller 2008", "10.1109/TPAMI.2007.1166"),
        ("Surface", "refinement over all views", "Furukawa & Ponce 2010", "10.1109/TPAMI.2009.161"),
        ("Surface", "the most probable surface", "MacKay 1992", "10.1162/neco.1992.4.3.415"),
    ]  # fmt: skip
    if sfm.get("camera") == "auto":
        found.append(("Calibration", "choice of the camera model", "Schwarz 1978", "10.1214/aos/1176344136"))
    if dense.get("shading"):
        found.append(("Surface", "stereoscopy and shading together", "Beil & Carlsen 1991", "10.1007/BF01815304"))
    found.append(("Pictures", "shaded relief", "Horn 1981", "10.1109/PROC.1981.11918"))
    order = ["Keypoints", "Matching", "Calibration", "Surface", "Pictures"]
    return tuple(sorted(found, key=lambda method: order.index(method[0])))


def methods_section(options: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the methods of a run as a section of its report."""
    found = methods(options)
    rows = "".join(
        f'<tr><th scope="row">{escape(stage if i == 0 or found[i - 1][0] != stage else "")}</th>'
        f"<td>{escape(what)}</td><td>{escape(paper)}</td><td>{_doi(doi)}</td></tr>"
        for i, (stage, what, paper, doi) in enumerate(found)
    )
    return (
        '<section><h2>Methods</h2><div class="scroll"><table><thead><tr><th>Stage</th><th>Method</th><th>Paper</th>'
        f"<th>DOI</th></tr></thead><tbody>{rows}</tbody></table></div></section>"
    )


def _doi(doi: str) -> str:
    return f'<a href="https://doi.org/{escape(doi)}" rel="noreferrer">{escape(doi)}</a>' if doi else "–"


def assumptions(report: Mapping[str, Any]) -> list[str]:
    """Return what no file told and the run assumed or was told by hand, one sentence each.

    Parameters
    ----------
    report : mapping
        As `semscape.report.report_to_dict` returns it.
    """
    told: dict[tuple[str, str], list[str]] = {}
    for item in report["inputs"]:
        for field, source in (item.get("source") or {}).items():
            if source != "file":
                told.setdefault((field, source), []).append(str(item["name"]))
    every = len(report["inputs"])
    sentences = [
        f"{_field_name(field)}: {_SOURCES.get(source, source)}, for {_which(names, every)}."
        for (field, source), names in told.items()
    ]
    if not every or any(item.get("pixel_size_um") is None for item in report["inputs"]):
        sentences.append("No pixel size is known: every length is in px of the reference view.")
    return sentences


_SOURCES = {
    "user": "given by the user",
    "sidecar": "from the file beside the image",
    "assumed": "assumed",
    "doubtful": "doubtful, as the file states it",
}


def _which(names: Sequence[str], every: int) -> str:
    if len(names) == every:
        return "every view"
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _field_name(field: str) -> str:
    for suffix in ("_um", "_rad", "_kv", "_px", "_rows"):
        field = field.removesuffix(suffix)
    words = field.replace("_", " ")
    return words[:1].upper() + words[1:]
