"""A part of the hostile inputs of `benchmarks/hostile.py`; all of them take a minute."""

from __future__ import annotations

import pytest

from fuzz_metadata import kept_inputs, run_one
from hostile import MAKERS, is_fault, try_case


@pytest.mark.filterwarnings("ignore")  # as in a run, where a library's warning ends nothing
@pytest.mark.parametrize("maker", range(len(MAKERS)))
def test_hostile_input_ends_in_success_or_a_semscape_error(maker: int) -> None:
    cases = [try_case(maker + len(MAKERS) * i) for i in range(14)]
    assert not [case for case in cases if is_fault(case)]
    assert {case["ended"] for case in cases} <= {"good", "refused"}


@pytest.mark.parametrize("number", [18, 160, 1282], ids=["deep", "long_integer", "infinite_rows"])
def test_inputs_that_once_got_through(number: int) -> None:
    assert try_case(number)["ended"] == "refused"


def test_what_fuzzing_has_found_to_be_interesting() -> None:
    inputs = kept_inputs()
    assert len(inputs) > 30
    for data in inputs:
        run_one(data)
