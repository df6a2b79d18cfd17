"""What the app's other processes calculate, several at a time."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from PIL import Image

from semscape.app.calculations import draw_image


def test_pictures_that_are_drawn_at_the_same_time_leave_each_other_alone(master_images: Path, tmp_path: Path) -> None:
    source = min(master_images.glob("*.tif"))
    targets = [tmp_path / f"{number}" for number in range(60)]
    with ThreadPoolExecutor(6) as threads:
        list(threads.map(lambda target: draw_image(source, 32, target), targets))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(target.name for target in targets)
    with Image.open(targets[0]) as picture:
        assert max(picture.size) == 32
