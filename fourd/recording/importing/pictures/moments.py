"""Pairs the images of a source's cameras by moment, and leaves out moments that a camera lacks."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from fourd.base.errors import UserError
from fourd.base.formats.frame_numbers import DIGITS
from fourd.recording.capture.layout import frame_name, sort_frames
from fourd.recording.capture.pictures.moments import match_frames
from fourd.recording.import_choices import PairBy
from fourd.recording.importing.imported import EncodedPictures, Imported, ImportedCamera, PictureFiles

MIN_SHARE = 0.5
"""With "auto", an error is raised if fewer than this fraction of all moments would be imported."""
MAX_LISTED = 5


def align_pictures(imported: Imported, pair_by: PairBy) -> tuple[Imported, list[str]]:
    """Pair the images of all cameras by moment. Afterwards, all cameras have the same frame names.

    Cameras with videos do not change.

    Args:
        imported: the content of a source.
        pair_by: how images are paired.

    Returns:
        The source with the moments that all cameras have, and lines about the moments that are left out.

    Raises:
        UserError: if no moment exists in all cameras, or, with "auto", if the names leave doubt about the moments.
    """
    cameras = {camera.name: camera for camera in imported.cameras if not _is_video(camera)}
    stems = {name: frame_names(camera) for name, camera in cameras.items()}
    if not stems:
        return imported, []
    frames, notes = _match(stems, pair_by)
    shared = sort_frames(set.intersection(*(set(found) for found in frames.values())))
    everything = sort_frames(set.union(*(set(found) for found in frames.values())))
    if pair_by == "auto":
        _refuse_shifted(frames)
    if not shared or (pair_by == "auto" and len(shared) < MIN_SHARE * len(everything)):
        raise _few_shared(frames, shared, everything)
    if len(shared) < len(everything):
        lost = [(name, [frame for frame in everything if frame not in found]) for name, found in frames.items()]
        texts = [f"{_frames(missing, shown=3)} in {name}" for name, missing in lost if missing]
        listed = ", ".join(texts[:MAX_LISTED]) + (", ..." if len(texts) > MAX_LISTED else "")
        notes.append(
            f"images are missing: {listed}; {len(shared)} of {len(everything)} frames are imported, those that all "
            "cameras have"
        )
    aligned = {name: _select(camera, frames[name], shared) for name, camera in cameras.items()}
    return replace(imported, cameras=tuple(aligned.get(each.name, each) for each in imported.cameras)), notes


def frame_names(camera: ImportedCamera) -> list[str]:
    """Return the names of a camera's frames in a source: given names, or file names without suffix, or positions.

    Raises:
        UserError: if two images have the same name.
        ValueError: if the camera has a video.
    """
    frames = camera.frames
    if not isinstance(frames, PictureFiles | EncodedPictures):
        raise ValueError("frames: expected images, got a video")
    names = list(frames.names)
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise UserError(
            f"camera '{camera.name}': expected one image per frame, got two called {repeated[0]}; rename or remove one"
        )
    return names


def _is_video(camera: ImportedCamera) -> bool:
    return not isinstance(camera.frames, PictureFiles | EncodedPictures)


def _match(stems: Mapping[str, Sequence[str]], pair_by: PairBy) -> tuple[dict[str, dict[str, str]], list[str]]:
    """Return the file names of each camera by frame name, and notes."""
    counts = {name: len(names) for name, names in stems.items()}
    if pair_by == "order":
        if len(set(counts.values())) > 1:
            least, most = min(counts, key=lambda name: counts[name]), max(counts, key=lambda name: counts[name])
            raise UserError(
                f"--pair-by order: expected the same number of images of all cameras, got {counts[least]} of '{least}' "
                f"and {counts[most]} of '{most}'; leave out the option to pair images by their names"
            )
        return {name: {frame_name(i): stem for i, stem in enumerate(names)} for name, names in stems.items()}, []
    single = {name: names[0] for name, names in stems.items()} if set(counts.values()) == {1} else {}
    if pair_by == "auto" and len(set(single.values())) > 1 and _is_one_moment(single):
        note = "the names of the images differ; they are taken as one moment: one image per camera"
        return {name: {frame_name(0): stem} for name, stem in single.items()}, [note]
    return match_frames(stems, renumber=True), []


def _is_one_moment(stems: Mapping[str, str]) -> bool:
    """Return whether single images with these names count as one moment. They do if the
    names contain the names of the cameras, or differ in more than a number, as left and right do."""
    if all(_contains(stem, name) for name, stem in stems.items()):
        return True
    return len({DIGITS.sub("#", stem) for stem in stems.values()}) > 1


def _contains(stem: str, camera: str) -> bool:
    """Return whether a file name contains the camera's name as a word."""
    return re.search(rf"(?<![0-9A-Za-z]){re.escape(camera)}(?![0-9A-Za-z])", stem) is not None


def _refuse_shifted(frames: Mapping[str, Mapping[str, str]]) -> None:
    """Raise UserError if the frame numbers of two cameras look like the same moments with different first numbers."""
    spans = {name: (min(numbers), max(numbers)) for name, found in frames.items() if (numbers := _numbers(found))}
    if len(spans) < len(frames):
        return
    usual = max(spans.values(), key=lambda span: sum(other == span for other in spans.values()))
    for name, span in spans.items():
        shift = span[0] - usual[0]
        if shift and span[1] - usual[1] == shift:
            other = next(each for each, of in spans.items() if of == usual)
            first = frames[name][frame_name(span[0])]
            raise UserError(
                f"camera '{name}': expected the frame numbers of camera '{other}' ({usual[0]} to {usual[1]}), got "
                f"{span[0]} to {span[1]} (first image: {first}), so it is unclear which images were taken at the same "
                "moment; rename the images, or import with --pair-by order if the first images of all cameras belong "
                "together, or with --pair-by name if equal numbers do"
            )


def _few_shared(
    frames: Mapping[str, Mapping[str, str]], shared: Collection[str], everything: Sequence[str]
) -> UserError:
    """Create the error for cameras that have too few moments in common. It names a camera and a missing frame."""
    usual = max(frames, key=lambda name: len(frames[name]))
    lacks = {name: [frame for frame in everything if frame not in found] for name, found in frames.items()}
    worst = max((name for name in frames if name != usual), key=lambda name: len(lacks[name]), default=usual)
    missing = next((frame for frame in frames[usual] if frame not in frames[worst]), everything[0])
    name = shlex.quote(str(frames[usual].get(missing, missing)))
    return UserError(
        f"camera '{worst}': expected images of the same frames as of camera '{usual}', got none for {name} and for "
        f"{len(lacks[worst]) - 1} other frames, so only {len(shared)} of {len(everything)} frames have images of all "
        "cameras; restore or rename the images, move this camera away, or import with --pair-by "
        + ("name to import only those frames" if shared else "order if the first images of all cameras belong together")
    )


def _numbers(frames: Collection[str]) -> list[int] | None:
    return [int(frame) for frame in frames] if all(frame.isdecimal() for frame in frames) else None


def _frames(names: Sequence[str], shown: int) -> str:
    texts = [str(int(name)) if name.isdecimal() else name for name in names]
    more = f" and {len(names) - shown} more" if len(names) > shown else ""
    return f"frame{'s' if len(names) > 1 else ''} {', '.join(texts[:shown])}{more}"


def _select(camera: ImportedCamera, frames: Mapping[str, str], shared: Sequence[str]) -> ImportedCamera:
    """Keep the frames ``shared`` of a camera, and rename them. ``frames`` has its file names by frame name."""
    position = {stem: index for index, stem in enumerate(frame_names(camera))}
    chosen = [position[frames[frame]] for frame in shared]
    pictures = camera.frames
    assert isinstance(pictures, PictureFiles | EncodedPictures)
    masks = None if camera.masks is None else _pick(camera.masks, chosen, shared)
    return replace(camera, frames=_pick(pictures, chosen, shared), masks=masks)


def _pick(
    files: PictureFiles | EncodedPictures, chosen: Sequence[int], names: Sequence[str]
) -> PictureFiles | EncodedPictures:
    """Keep the images at the positions ``chosen``, and rename them to ``names``."""
    if isinstance(files, PictureFiles):
        return PictureFiles(tuple(files.paths[index] for index in chosen), tuple(names))
    return replace(files, count=len(chosen), read=_Chosen(files.read, tuple(chosen)), given_names=tuple(names))


@dataclass(frozen=True)
class _Chosen:
    """Reads some of the encoded images of a larger file."""

    read: Callable[[int], bytes]
    chosen: tuple[int, ...]

    def __call__(self, index: int) -> bytes:
        return self.read(self.chosen[index])
