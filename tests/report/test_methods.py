"""The methods that a report names are those that its options chose, each once and with its DOI."""

from __future__ import annotations

from dataclasses import replace

from semscape.options import DenseOptions, Options, SfmOptions
from semscape.report.methods import methods, methods_section


def papers(options: Options) -> list[str]:
    return [paper for _, _, paper, _ in methods(options.to_dict())]


def test_every_run_names_what_it_rests_on() -> None:
    named = papers(Options())
    assert len(set(named)) == len(named)
    assert {"Lowe 2004", "Moisan & Stival 2004", "Storn & Price 1997", "MacKay 1992", "Beil & Carlsen 1991"} <= set(
        named
    )
    page = methods_section(Options().to_dict())
    assert all(paper.replace("&", "&amp;") in page for paper in named)


def test_what_was_not_asked_is_not_named() -> None:
    assert "Beil & Carlsen 1991" not in papers(Options(dense=DenseOptions(shading=False)))
    affine = replace(Options(), sfm=SfmOptions(camera="parallel"))
    assert "Schwarz 1978" not in papers(affine)
    assert "Schwarz 1978" in papers(replace(Options(), sfm=SfmOptions(camera="auto")))
