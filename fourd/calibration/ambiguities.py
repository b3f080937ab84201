"""What a calibration leaves open, settled by its pictures: how these were resized, where the principal points lie."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fourd.calibration.image_sizes import SizeChoice, black_borders, pick_size, size_hypotheses
from fourd.calibration.matching import Matches, supported, undistorted
from fourd.calibration.plane_matching import Patch, flat_matches
from fourd.calibration.principal_points import MOST_COMBINATIONS, MirrorChoice, pick_centres, principal_point_hypotheses
from fourd.calibration.residuals import LEAST_MATCHES, LEAST_PAIRS, WORST_PX, Pair, matched_pairs, residuals_of
from fourd.cameras import Camera
from fourd.capture.focus import find_focus
from fourd.errors import UserError
from fourd.progress import Track, untracked

Picture = NDArray[np.uint8]
Centres = Literal["auto", "as-given", "mirrored"]

LEAST_FEATURES = 20
"""Seen from far apart, repeated patterns gave 8 wrong matches that a plane supported."""
NONE = Matches(np.zeros((0, 2)), np.zeros((0, 2)))
GROUND = (0.0, -0.02, 0.02)
"""Heights in metres at which the ground is sought, one after the other until there are matches."""
HALF_SIDE_M = 2.5
METRIC = (0.5, 50.0)
"""Distances between cameras that a calibration in metres has."""
UPRIGHT = 0.5
"""Mean z of the pictures' up directions in a world whose z is up."""
MOST_RASTER = 2000
CENTRED = ("unchanged", "scaled", "stretched", "letterboxed", "filled", "cropped centre")


@dataclass(frozen=True, eq=False)
class Settled:
    """Lenses that fit their pictures.

    Attributes:
        lenses: one a camera, of its pictures' size.
        notes: what was chosen and why, a line each.
        warnings: what looks wrong and was left as it is.
    """

    lenses: tuple[Camera, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def matches_of_cameras(
    pictures_by_frame: Sequence[Sequence[Picture]], lenses: Sequence[Camera], track: Track | None = None
) -> dict[Pair, Matches]:
    """Matches of pairs of cameras, of all given frames together, in the pictures' own pixels.

    Features first: fewer than 20 of a pair count as none. Cameras that share them with fewer than two
    others (wide baselines) are matched on the ground as well, where the world is in metres with z up:
    within 2.5 m of the point below the cameras' common focus, at z = 0, and 2 cm below and above where
    that gives too few. A pair has the matches of the kind that gives more.

    Args:
        pictures_by_frame: for each frame an RGB picture (H, W, 3) of each camera, of its lens's size.
        lenses: the calibration, which chooses where to look and never what is found.
        track: wraps loops, for progress.

    Raises:
        ValueError: when a picture is not of its lens's size.
    """
    track = track or untracked
    matches: dict[Pair, Matches] = {}
    for frame in track(range(len(pictures_by_frame)), len(pictures_by_frame), "features"):
        _join(matches, matched_pairs(pictures_by_frame[frame], lenses))
    matches = {pair: found if len(found) >= LEAST_FEATURES else NONE for pair, found in matches.items()}
    good = [pair for pair, found in matches.items() if len(found)]
    lonely = {index for index in range(len(lenses)) if sum(index in pair for pair in good) < LEAST_PAIRS}
    pairs = [pair for pair in matches if set(pair) & lonely]
    grounds = _grounds(lenses)
    for place in track(range(len(pairs)), len(pairs), "ground") if grounds else ():
        i, j = pairs[place]
        on_ground: dict[Pair, Matches] = {}
        for ground in grounds:
            for pictures in pictures_by_frame:
                found = flat_matches(pictures[i], pictures[j], (lenses[i], lenses[j]), ground)
                _join(on_ground, {(i, j): _supported(found, lenses[i], lenses[j])})
            if len(on_ground[i, j]) >= LEAST_MATCHES:
                break
        matches[i, j] = max(matches[i, j], on_ground[i, j], key=len)
    return matches


def _join(matches: dict[Pair, Matches], more: Mapping[Pair, Matches]) -> None:
    for pair, found in more.items():
        matches[pair] = matches[pair].joined(found) if pair in matches else found


def _supported(found: Matches, first: Camera, second: Camera) -> Matches:
    straight = Matches(undistorted(first, found.first_px), undistorted(second, found.second_px))
    kept = supported(straight, second.width, second.height)
    return Matches(found.first_px[kept], found.second_px[kept])


def _grounds(lenses: Sequence[Camera]) -> list[Patch]:
    """Squares of ground to look at; none where the world is not in metres with z up."""
    apart = [float(np.linalg.norm(a.centre - b.centre)) for a, b in combinations(lenses, 2)]
    up = float(np.mean([-lens.rotation[1, 2] for lens in lenses]))
    focus = find_focus(list(lenses))
    if focus is None or not apart or not (METRIC[0] <= min(apart) and max(apart) <= METRIC[1] and up >= UPRIGHT):
        return []
    distances = [float(np.linalg.norm(lens.centre - focus)) for lens in lenses]
    finest = float(np.median([lens.intrinsics[0, 0] / away for lens, away in zip(lenses, distances, strict=True)]))
    resolution = min(finest, MOST_RASTER / (2 * HALF_SIDE_M))
    x, y = focus[0] - HALF_SIDE_M, focus[1] + HALF_SIDE_M
    right, down = np.array([1.0, 0, 0]), np.array([0, -1.0, 0])
    side = 2 * HALF_SIDE_M
    return [Patch(np.array([x, y, z]), right, down, side, side, resolution) for z in GROUND]


def settle(
    names: Sequence[str],
    lenses: Sequence[Camera],
    pictures_by_frame: Sequence[Sequence[Picture]],
    *,
    resize: str = "auto",
    centres: Centres = "auto",
    track: Track | None = None,
) -> Settled:
    """Fit a calibration to its pictures: their size, and the side of the middle on which principal points lie.

    Args:
        names: of the cameras.
        lenses: the calibration as given.
        pictures_by_frame: for each of a few frames the pictures (H, W, 3) of all cameras, as stored.
        resize: how pictures came to another size than their calibration's, by the names of
            :func:`fourd.calibration.image_sizes.size_hypotheses`; ``auto`` decides by black borders and matches.
        centres: ``as-given``; ``auto`` warns where mirrored principal points agree clearly better;
            ``mirrored`` applies them. Looked at for 2 to 5 cameras.
        track: wraps loops, for progress.

    Raises:
        UserError: when it is not clear how pictures were resized, ``resize`` is no way to their size, or
            ``mirrored`` was asked for and the pictures do not say how.
    """
    sizes = [(picture.shape[1], picture.shape[0]) for picture in pictures_by_frame[0]]
    resized = [i for i, lens in enumerate(lenses) if sizes[i] != (lens.width, lens.height)]
    few = len(lenses) >= 2 and 4 ** len(lenses) <= MOST_COMBINATIONS
    if centres == "mirrored" and not few:
        raise UserError(f"--centres mirrored: expected 2 to 5 cameras, got {len(lenses)}; mend the calibration")
    notes: list[str] = []
    name = "unchanged"
    matches: dict[Pair, Matches] | None = None
    if resized:
        asked = None if resize == "auto" else resize
        _check_way(asked, [(names[i], size_hypotheses(lenses[i], *sizes[i])) for i in resized])
        if asked is None:
            name, why, matches = _size(names, lenses, sizes, resized, pictures_by_frame, few, track)
        else:
            name, why = asked, "as --resize says"
        notes.append(f"{', '.join(names[i] for i in resized)}: {_shapes(lenses, sizes, resized)}: {name} ({why})")
    elif resize != "auto":
        notes.append(f"--resize {resize}: all pictures have their calibration's size; nothing to do")
    fitted = _fitted(lenses, sizes, name)
    if centres == "as-given" or not few:
        return Settled(fitted, tuple(notes), ())
    if name not in CENTRED:
        if centres == "mirrored":
            raise UserError(
                "--centres mirrored: expected whole pictures, got some cropped to a side; mend the calibration"
            )
        return Settled(fitted, (*notes, "mirrored principal points: not looked for in cropped pictures"), ())
    if matches is None:
        matches = matches_of_cameras(pictures_by_frame, fitted, track)
    return _centres(names, fitted, matches, centres, notes)


def _fitted(lenses: Sequence[Camera], sizes: Sequence[tuple[int, int]], name: str) -> tuple[Camera, ...]:
    found = [size_hypotheses(lens, *size) for lens, size in zip(lenses, sizes, strict=True)]
    return tuple(option["unchanged"] if "unchanged" in option else option[name] for option in found)


def _shapes(lenses: Sequence[Camera], sizes: Sequence[tuple[int, int]], resized: Sequence[int]) -> str:
    pairs = dict.fromkeys(f"{lenses[i].width} x {lenses[i].height} -> {sizes[i][0]} x {sizes[i][1]}" for i in resized)
    return ", ".join(pairs)


def _check_way(asked: str | None, options: Sequence[tuple[str, Mapping[str, Camera]]]) -> None:
    """Whether a way of resizing would make all pictures."""
    common = [way for way in options[0][1] if all(way in found for _, found in options)]
    cameras = ", ".join(name for name, _ in options)
    if not common:
        raise UserError(
            f"{cameras}: expected pictures that were all resized in one way, got sizes that none explains; "
            "export them at the calibration's size"
        )
    if asked is not None and asked not in common:
        raise UserError(f"--resize: expected one of {', '.join(common)} for {cameras}, got '{asked}'; choose one")


def _size(
    names: Sequence[str],
    lenses: Sequence[Camera],
    sizes: Sequence[tuple[int, int]],
    resized: Sequence[int],
    pictures_by_frame: Sequence[Sequence[Picture]],
    few: bool,
    track: Track | None,
) -> tuple[str, str, dict[Pair, Matches]]:
    """The way in which pictures were resized, why, and the matches that say so."""
    borders = {i: black_borders([pictures[i] for pictures in pictures_by_frame]) for i in resized}
    guess = pick_size({}, lenses, sizes, borders)
    matches = matches_of_cameras(pictures_by_frame, guess.lenses, track)
    choice = pick_size(matches, lenses, sizes, borders)
    if not choice.is_clear and few:
        # Mirrored principal points drown what the sizes differ by: without them it may be clear.
        mirrors = _mirrors(matches, choice.lenses)
        if mirrors is not None and mirrors.is_clear:
            mended = [principal_point_hypotheses(lens)[name] for lens, name in zip(lenses, mirrors.names, strict=True)]
            again = pick_size(matches, mended, sizes, borders)
            choice = again if again.is_clear else choice
    if not choice.is_clear:
        raise UserError(
            f"{', '.join(names[i] for i in resized)}: expected pictures of the calibration's size or a clear way to "
            f"theirs, got {_shapes(lenses, sizes, resized)} ({choice.why}); look at them and say --resize NAME"
        )
    return choice.name, _evidence(choice, [max(b.left, b.top, b.right, b.bottom) for b in borders.values()]), matches


def _evidence(choice: SizeChoice, widths: Sequence[float]) -> str:
    bars = f"black bars of {min(widths):.1f} to {max(widths):.1f} pixels; " if min(widths) > 0 else ""
    return bars + choice.why


def _mirrors(matches: Mapping[Pair, Matches], lenses: Sequence[Camera]) -> MirrorChoice | None:
    """None where there are too few matches to tell."""
    if not residuals_of(matches, lenses).pairs:
        return None
    return pick_centres(matches, lenses)


def _centres(
    names: Sequence[str],
    lenses: tuple[Camera, ...],
    matches: Mapping[Pair, Matches],
    centres: Centres,
    notes: Sequence[str],
) -> Settled:
    found = _mirrors(matches, lenses)
    counts = sum(map(len, matches.values()))
    if found is None:
        said = f"residuals: too few matches between the cameras to judge the calibration ({counts})"
        if centres == "mirrored":
            raise UserError(f"--centres mirrored: expected matches to judge by, got {counts}; mend the calibration")
        return Settled(lenses, (*notes, said), ())
    are_given = set(found.names) == {"as given"}
    which = ", ".join(
        f"{name} {what.removeprefix('mirrored ')}"
        for name, what in zip(names, found.names, strict=True)
        if what != "as given"
    )
    numbers = (
        f"residuals of {counts} matches: {found.given_px:.1f} px as given, {found.chosen_px:.1f} px mirrored, "
        f"{found.next_px:.1f} px the next best"
    )
    if found.is_clear and not are_given and (centres == "mirrored" or found.given_px > WORST_PX):
        if centres == "mirrored":
            return Settled(found.lenses, (*notes, f"principal points mirrored: {which} ({numbers})"), ())
        warning = f"principal points look mirrored: {which} ({numbers}); left so; apply it with --centres mirrored"
        return Settled(lenses, tuple(notes), (warning,))
    agreed = f"residuals: {found.given_px:.1f} px in the mean, of {counts} matches"
    if centres == "mirrored" and not (are_given or found.given_px <= WORST_PX):
        raise UserError(f"--centres mirrored: expected a clear choice, got {which}: {numbers}; mend the calibration")
    if centres == "mirrored":
        return Settled(lenses, (*notes, f"{agreed}; principal points agree as given: none is mirrored"), ())
    if found.given_px > WORST_PX:
        warning = (
            f"cameras disagree: {agreed}, no principal point clearly mirrored; calibrate again, or with --calibrate"
        )
        return Settled(lenses, tuple(notes), (warning,))
    return Settled(lenses, (*notes, agreed), ())
