"""The training set: keypoints of groups of images, each labelled by whether it found a partner.

The rule is the thesis's (2.4): in each group one image is drawn at random and matched with every other one by
SIFT, nearest neighbours and RANSAC, here a contrario; a keypoint with a verified correspondence in at least one
other image is significant. With `every_image` each image is labelled against all others.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semscape.errors import BadInputError, TooFewMatchesError
from semscape.features.detect import detect
from semscape.features.traits import TRAITS, keypoint_traits, trait_names
from semscape.options import Options
from semscape.sfm.two_view import match_pair
from semscape.types import BoolArray, FloatArray, IntArray, Keypoints, TiltSeries, _Value

ALL_TRAITS = tuple(TRAITS)
ARRAYS = ("x", "y", "features", "class", "group", "image", "names", "groups", "images", "n_detected")


@dataclass(frozen=True, eq=False)
class Dataset(_Value):
    """Labelled keypoints.

    Parameters
    ----------
    xy : (N, 2) float
        In px.
    features : (N, F) float32
        Traits, in the columns that `names` names.
    significant : (N,) bool
        The class.
    group, image : (N,) int
        Indices into `groups` and `images`.
    names, groups, images : tuples of str
        Traits; folders; GROUP/FILE of every image of every group, labelled or not.
    n_detected : (I,) int
        Keypoints detected in each image.
    """

    xy: FloatArray
    features: NDArray[np.float32]
    significant: BoolArray
    group: IntArray
    image: IntArray
    names: tuple[str, ...]
    groups: tuple[str, ...]
    images: tuple[str, ...]
    n_detected: IntArray

    def __len__(self) -> int:
        return len(self.xy)

    @property
    def specimen(self) -> tuple[str, ...]:
        """The specimen of each group: the folder's name up to the first "-", so "fracture-0" is a "fracture"."""
        return tuple(name.split("-")[0] for name in self.groups)

    def only(self, rows: IntArray | BoolArray) -> Dataset:
        """Return the dataset of some rows."""
        return replace(
            self,
            xy=self.xy[rows],
            features=self.features[rows],
            significant=self.significant[rows],
            group=self.group[rows],
            image=self.image[rows],
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the plain arrays that a file holds: x, y, features, class, group, image, and what names them."""
        return {
            "x": self.xy[:, 0],
            "y": self.xy[:, 1],
            "features": self.features,
            "class": self.significant,
            "group": self.group,
            "image": self.image,
            "names": np.array(self.names),
            "groups": np.array(self.groups),
            "images": np.array(self.images),
            "n_detected": self.n_detected,
        }

    def columns(self, trait_groups: Sequence[str]) -> NDArray[np.float32]:
        """Return the features (N, F) of some groups of traits.

        Examples
        --------
        >>> from semscape.learning.dataset import concatenate
        >>> one = Dataset(np.zeros((1, 2)), np.array([[3.0, 5.0]], np.float32), np.array([True]), np.zeros(1, int),
        ...     np.zeros(1, int), ("log_scale", "log_response"), ("a",), ("a/1.tif",), np.array([1]))
        >>> one.columns(["detector"]).tolist(), len(concatenate([one, one]))
        ([[3.0, 5.0]], 2)
        """
        return self.features[:, [self.names.index(name) for name in trait_names(trait_groups)]]

    def counts(self) -> list[tuple[str, int, int, int, int]]:
        """Return per group: its name, images, keypoints detected, keypoints labelled, significant ones."""
        of_image = np.array([self.groups.index(name.rpartition("/")[0]) for name in self.images])
        return [
            (
                name,
                int((of_image == index).sum()),
                int(self.n_detected[of_image == index].sum()),
                int((self.group == index).sum()),
                int(self.significant[self.group == index].sum()),
            )
            for index, name in enumerate(self.groups)
        ]


def label_group(name: str, series: TiltSeries, options: Options, *, seed: int, every_image: bool = False) -> Dataset:
    """Label the keypoints of one group of images.

    Parameters
    ----------
    name : str
        Of the group; with the seed it decides which image is drawn.
    series : TiltSeries
        Two images or more of one specimen.
    options : Options
        Of keypoints, matching and RANSAC; the second, guided pass of matching is left out.
    seed : int
    every_image : bool
        Label every image instead of the one that is drawn.

    Raises
    ------
    BadInputError
        When the group has one image, or no image matches another.
    """
    if series.n_views < 2:
        raise BadInputError(f"group {name} has {series.n_views} image, a label needs another one to match with")
    features = replace(options.features, guided=False, detector="sift", significance_keep=1.0)
    keypoints = tuple(detect(view, features) for view in series.views)
    stream = zlib.crc32(name.encode())
    drawn = int(np.random.default_rng([seed, stream]).integers(series.n_views))
    labels = [np.zeros(len(found), dtype=bool) for found in keypoints]
    n_matched = 0
    for pair in combinations(range(series.n_views), 2):
        if not (every_image or drawn in pair):
            continue
        rng = np.random.default_rng([seed, stream, *pair])
        try:
            matches, geometry = match_pair(pair, keypoints, series.names, series.shape, features, options.robust, rng)
        except TooFewMatchesError:
            continue  # no correspondence between these two is an answer
        n_matched += 1
        for view, rows in zip(pair, matches.indices[geometry.inliers].T, strict=True):
            labels[view][rows] = True
    if n_matched == 0:
        raise BadInputError(f"group {name}: no image matches another; leave it out, it has nothing to teach")
    images = range(series.n_views) if every_image else [drawn]
    return Dataset(
        xy=np.concatenate([keypoints[i].xy for i in images]),
        features=np.concatenate([keypoint_traits(series.views[i], keypoints[i], ALL_TRAITS) for i in images]),
        significant=np.concatenate([labels[i] for i in images]),
        group=np.zeros(sum(len(keypoints[i]) for i in images), np.int64),
        image=np.repeat(list(images), [len(keypoints[i]) for i in images]),
        names=trait_names(ALL_TRAITS),
        groups=(name,),
        images=tuple(f"{name}/{image}" for image in series.names),
        n_detected=_lengths(keypoints),
    )


def dataset_of_arrays(arrays: Mapping[str, NDArray[Any]], name: str) -> Dataset:
    """Return the dataset of the arrays that `Dataset.arrays` gave.

    Raises
    ------
    BadInputError
        For arrays that do not belong together, or traits of another version of semscape.
    """
    names = tuple(str(item) for item in arrays["names"])
    n = len(arrays["x"])
    lengths = {len(arrays[key]) for key in ("y", "features", "class", "group", "image")}
    places = (("group", len(arrays["groups"])), ("image", len(arrays["images"])))
    sound = (
        names == trait_names(ALL_TRAITS)
        and lengths == {n}
        and arrays["features"].shape == (n, len(names))
        and arrays["features"].dtype == np.float32
        and arrays["class"].dtype == np.bool_
        and all(np.isin(arrays[key], np.arange(count)).all() for key, count in places)
        and len(arrays["n_detected"]) == len(arrays["images"])
    )
    if not sound:
        raise BadInputError(
            f"{name} does not hang together or is of another version of semscape; make it again with semscape dataset"
        )
    return Dataset(
        xy=np.column_stack([arrays["x"], arrays["y"]]),
        features=arrays["features"],
        significant=arrays["class"],
        group=arrays["group"],
        image=arrays["image"],
        names=names,
        groups=tuple(str(item) for item in arrays["groups"]),
        images=tuple(str(item) for item in arrays["images"]),
        n_detected=arrays["n_detected"],
    )


def concatenate(parts: Sequence[Dataset]) -> Dataset:
    """Return one dataset of several, in their order."""
    groups = np.cumsum([0, *(len(part.groups) for part in parts)])
    images = np.cumsum([0, *(len(part.images) for part in parts)])
    return Dataset(
        xy=np.concatenate([part.xy for part in parts]),
        features=np.concatenate([part.features for part in parts]),
        significant=np.concatenate([part.significant for part in parts]),
        group=np.concatenate([part.group + first for part, first in zip(parts, groups, strict=False)]),
        image=np.concatenate([part.image + first for part, first in zip(parts, images, strict=False)]),
        names=parts[0].names,
        groups=sum((part.groups for part in parts), ()),
        images=sum((part.images for part in parts), ()),
        n_detected=np.concatenate([part.n_detected for part in parts]),
    )


def capped(dataset: Dataset, rows_per_group: int, *, rng: np.random.Generator) -> Dataset:
    """Return the dataset with at most so many rows of each group, drawn at random, in their order."""
    chosen = []
    for index in range(len(dataset.groups)):
        rows = np.flatnonzero(dataset.group == index)
        chosen.append(rng.permutation(rows)[:rows_per_group])
    return dataset.only(np.sort(np.concatenate(chosen)))


def _lengths(keypoints: Sequence[Keypoints]) -> IntArray:
    return np.array([len(found) for found in keypoints], dtype=np.int64)
