"""A part of the hostile inputs of `benchmarks/hostile.py`; all of them take minutes."""

from __future__ import annotations

import pytest

from fuzz_metadata import kept_inputs, run_one
from hostile import MAKERS, is_fault, try_case, try_deep_case
from hostile_deep import DEEP_MAKERS


@pytest.mark.filterwarnings("ignore")  # as in a run, where a library's warning ends nothing
@pytest.mark.parametrize("maker", range(len(MAKERS)))
def test_hostile_input_ends_in_success_or_a_semscape_error(maker: int) -> None:
    cases = [try_case(maker + len(MAKERS) * i) for i in range(14)]
    assert not [case for case in cases if is_fault(case)]
    assert {case["ended"] for case in cases} <= {"good", "refused"}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("maker", range(len(DEEP_MAKERS)), ids=[maker.__name__ for maker in DEEP_MAKERS])
def test_hostile_input_that_gets_past_the_first_checks(maker: int) -> None:
    cases = [try_deep_case(maker + len(DEEP_MAKERS) * i) for i in range(3)]
    assert not [case for case in cases if is_fault(case)]
    assert {case["ended"] for case in cases} <= {"good", "refused"}


@pytest.mark.filterwarnings("ignore")
def test_a_fair_share_gets_deep() -> None:
    """Else the corpus would only show that the first check works."""
    reached = [try_deep_case(number)["reached"] for number in (4, 5, 6, 8, 9, 14, 157)]
    assert reached.count("whole run") >= 4
    assert "surface" in reached  # a header's pixel sizes differ by 20: no height fits


@pytest.mark.parametrize("number", [18, 160, 1282], ids=["deep", "long_integer", "infinite_rows"])
def test_inputs_that_once_got_through(number: int) -> None:
    assert try_case(number)["ended"] == "refused"


def test_what_fuzzing_has_found_to_be_interesting() -> None:
    inputs = kept_inputs()
    assert len(inputs) > 30
    for data in inputs:
        run_one(data)
