"""Applies edits to a scene file. One frame at a time is in memory."""

from __future__ import annotations

from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fourd.base.errors import UserError
from fourd.base.progress import Log, Track
from fourd.recording.capture.layout import parse_frame_range
from fourd.scene.container import SceneReader, SceneWriter
from fourd.scene.editing.geometry import SceneGeometry, parse_region, shifted, turned, upright
from fourd.scene.editing.merging import Merged, OnBackground, without_views
from fourd.scene.editing.similarity import Similarity
from fourd.scene.editing.sound import edited_sound
from fourd.scene.editing.sources import Cropped, FrameSource, Mapped, Trimmed, WithoutBackground, moved, tinted
from fourd.scene.editing.tint import Tint
from fourd.scene.files.encoding import Tier
from fourd.scene.files.sound import OpusSound
from fourd.scene.packing.pack import pack_scene
from fourd.scene.packing.transcode import copy_frames
from fourd.scene.scene import to_triple


@dataclass(frozen=True)
class Placement:
    """Where a scene is moved. Lengths are in metres if the length of its world unit is known, and else in world units.

    The parts are applied in this order.

    Attributes:
        to_metres: scale the coordinates so that a world unit is a metre.
        scale: factor of all lengths.
        up: axis to which the up direction is turned, such as "z" or "-y", or None to keep it.
        is_on_floor: move the scene along its up direction so that the floor is at 0.
        turn_degrees: rotation about the up direction through the origin.
        move: translation (x, y, z).
    """

    to_metres: bool = False
    scale: float = 1.0
    up: str | None = None
    is_on_floor: bool = False
    turn_degrees: float = 0.0
    move: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def apply(self, source: FrameSource, name: Path) -> FrameSource:
        """Return the moved scene. ``name`` is the file in error messages."""
        unit = source.manifest.metres_per_unit
        if self.to_metres:
            if unit is None:
                raise UserError(
                    f"{name}: --metres: expected a scene that states its world unit, got one whose unit is not known; "
                    "scale it with --scale"
                )
            source = moved(source, Similarity(unit, np.eye(3), np.zeros(3)))
        if self.scale != 1:
            source = moved(source, Similarity(self.scale, np.eye(3), np.zeros(3)))
        if self.up is not None:
            source = moved(source, upright(SceneGeometry(source), self.up))
        geometry = SceneGeometry(source)
        if self.is_on_floor:
            source = moved(source, shifted(-geometry.floor * geometry.up))
        if self.turn_degrees:
            source = moved(source, turned(geometry.up, self.turn_degrees))
        if any(self.move):
            source = moved(source, shifted(geometry.unit * np.asarray(self.move)))
        return source


@dataclass(frozen=True)
class Edits:
    """What is changed. The parts are applied in this order.

    Attributes:
        trim: frames to keep, A:B or A:B:S, counted from 0, or None for all.
        crops: values of --crop, see :func:`fourd.scene.editing.geometry.parse_region`. Points outside one of them are
            left out.
        floater_share: see :class:`fourd.scene.editing.sources.Cropped`; None keeps floaters.
        gains: factors of red, green and blue.
        placement: where the scene is moved.
        merge: another scene, whose subject is added, or None.
        merge_at: where the other scene is moved.
        background: another scene, whose static points become the background, or None.
        has_background: whether the scene keeps its own static points.
        speed: factor of the frame rate.
    """

    trim: str | None = None
    crops: tuple[str, ...] = ()
    floater_share: float | None = None
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    placement: Placement = Placement()
    merge: Path | None = None
    merge_at: Placement = Placement()
    background: Path | None = None
    has_background: bool = True
    speed: float = 1.0

    @property
    def keeps_points(self) -> bool:
        """Whether all points of the chosen frames stay as they are."""
        kept = replace(self, trim=None, speed=1.0, has_background=True)
        return kept == Edits()


@dataclass(frozen=True)
class EditReport:
    """Numbers of frames, and mean numbers of dynamic points of the kept frames, before and after an edit."""

    frames_before: int
    frames: int
    points_before: float
    points: float


def edit_scene(
    source: Path, out: Path, edits: Edits, tier: Tier | None, scratch: Path, track: Track, log: Log
) -> EditReport:
    """Write the edited scene ``source`` as ``out``.

    Args:
        tier: the tier of the packed result. None keeps the tier of ``source``, which may be none.
        scratch: folder for a temporary file, on the same disk as ``out``.
        track: reports progress.
        log: called with a line on what an edit changes besides what was asked for.

    Raises:
        UserError: if a scene cannot be read or written, or if an edit does not apply to it.
    """
    with ExitStack() as stack:
        reader = stack.enter_context(closing(SceneReader(source)))
        before, encoding = reader.manifest, reader.manifest.encoding
        chosen = parse_frame_range(edits.trim, before.frame_count, "scene", "--trim")
        edited = _edited(reader, source, edits, chosen, stack, log)
        sound = edited_sound(reader, chosen, edits.speed, log)
        if encoding is not None and edits.keeps_points and tier in (None, encoding.tier):
            copied = edited.manifest
            if copied.kind == "object":
                encoding = replace(encoding, background=None)
            copy_frames(reader, out, chosen, replace(copied, encoding=encoding), sound, track)
            mean = float(np.mean(copied.points))
            return EditReport(before.frame_count, len(chosen), mean, mean)
        if tier is None and encoding is not None:
            tier = "light" if edited.manifest.view_count == 0 else encoding.tier
        raw = out if tier is None else scratch / "edited.4dv"
        counts = _write(edited, raw, source, sound, track)
        if tier is not None:
            pack_scene(raw, out, tier, track)
    counts_before = [before.points[index] for index in chosen]
    return EditReport(before.frame_count, len(chosen), float(np.mean(counts_before)), float(np.mean(counts)))


def _edited(reader: SceneReader, name: Path, edits: Edits, chosen: range, stack: ExitStack, log: Log) -> FrameSource:
    """Return the edited scene. Other scenes are opened until ``stack`` ends."""
    edited: FrameSource = Trimmed(reader, chosen)
    if edits.crops or edits.floater_share is not None:
        geometry = SceneGeometry(edited)
        regions = tuple(parse_region(text, geometry) for text in edits.crops)
        edited = Cropped(edited, regions, edits.floater_share)
    if edits.gains != (1.0, 1.0, 1.0):
        edited = tinted(edited, Tint(edits.gains))
    edited = edits.placement.apply(edited, name)
    if not edits.has_background:
        edited = WithoutBackground(edited)
    if edits.merge is not None or edits.background is not None:
        log("the colours become spherical harmonics, as in the tier light, because the scenes' source views differ")
        edited = without_views(edited)
    if edits.merge is not None:
        edited = _merged(edited, edits.merge, edits.merge_at, stack, log)
    if edits.background is not None:
        edited = OnBackground(edited, without_views(_opened_with_background(edits.background, edited, stack)))
    if edits.speed != 1:
        fps = edited.manifest.fps * edits.speed
        edited = Mapped(edited, replace(edited.manifest, fps=fps), lambda frame: frame)
    return edited


def _merged(edited: FrameSource, path: Path, place: Placement, stack: ExitStack, log: Log) -> FrameSource:
    other: FrameSource = stack.enter_context(closing(SceneReader(path)))
    if other.manifest.frame_count == 0:
        raise UserError(f"{path}: expected a scene with at least one frame, got none; export the run again")
    if other.manifest.background is not None:
        log(f"{path}: its background is left out")
        other = WithoutBackground(other)
    other = place.apply(_in_unit_of(other, edited), path)
    return Merged(edited, without_views(other))


def _opened_with_background(path: Path, edited: FrameSource, stack: ExitStack) -> FrameSource:
    scenery: FrameSource = stack.enter_context(closing(SceneReader(path)))
    if scenery.manifest.background is None:
        raise UserError(
            f"{path}: --background: expected a scene with a background, got one of a subject alone; train it with "
            "--scene full"
        )
    return _in_unit_of(scenery, edited)


def _in_unit_of(other: FrameSource, scene: FrameSource) -> FrameSource:
    """Scale ``other`` to the world unit of ``scene``, if the units of both are known."""
    own, wanted = other.manifest.metres_per_unit, scene.manifest.metres_per_unit
    if own is None or wanted is None or own == wanted:
        return other
    return moved(other, Similarity(own / wanted, np.eye(3), np.zeros(3)))


def _write(edited: FrameSource, out: Path, name: Path, sound: OpusSound | None, track: Track) -> list[int]:
    """Write all frames, and return their numbers of points."""
    manifest, counts = edited.manifest, []
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    with SceneWriter(out, replace(manifest, points=(), encoding=None, background=None)) as writer:
        if sound is not None:
            writer.add_sound(sound)
        background = edited.read_background()
        if background is not None:
            writer.add_background(background)
        for index in track(range(manifest.frame_count), manifest.frame_count, "edit"):
            frame = edited.read_dynamic(index)
            writer.add_frame(index, frame, edited.read_shadow(index))
            counts.append(frame.point_count)
            if frame.point_count:
                lower, upper = np.minimum(lower, frame.xyz.min(axis=0)), np.maximum(upper, frame.xyz.max(axis=0))
        if not any(counts):
            raise UserError(
                f"{name}: expected an edit that keeps points, got one that keeps none; keep a larger region"
            )
        writer.manifest = replace(writer.manifest, bounds=(to_triple(lower), to_triple(upper)))
    return counts
