"""A profile that leads far out of the map."""

from __future__ import annotations

import numpy as np
import pytest

from semscape.errors import NoAnswerError
from semscape.metrology.profile import extract_profile


def test_a_profile_far_longer_than_the_map_is_refused_before_it_is_sampled() -> None:
    with pytest.raises(NoAnswerError, match="only 40 x 20"):
        extract_profile(np.zeros((20, 40)), 1.0, np.zeros(2), np.array([1e12, 0.0]))
