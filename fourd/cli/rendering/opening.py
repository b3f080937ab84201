"""Opens what `fourd render` renders: a run, a scene or meshes, plain, in a style or through a lens."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fourd.base.errors import UserError
from fourd.base.storage import Location
from fourd.cli.rendering.lens_options import LensOptions

if TYPE_CHECKING:
    from fourd.scene.lenses.inserts import Insert
    from fourd.scene.playable import Playable


def open_source(source: Location, style_name: str | None, *, keeps_paper: bool) -> Playable:
    """Open a source, which is drawn in a style if there is a name. Without ``keeps_paper``, the paper of the style is
    replaced by the background. Raises UserError."""
    from fourd.scene.meshes.playable import PlayableMeshes
    from fourd.scene.meshes.source import is_mesh
    from fourd.scene.playable import open_playable
    from fourd.scene.styles import load_style, without_paper
    from fourd.viewer.playback.sources import open_frame_source
    from fourd.viewer.rendering.drawn_playable import DrawnPlayable, StyleDrawer

    style = None if style_name is None else load_style(style_name)
    if style is not None and not keeps_paper:
        style = without_paper(style)
    if isinstance(source, Path) and is_mesh(source):
        return PlayableMeshes(source, style)
    playable = open_playable(source)
    if style is None:
        return playable
    return DrawnPlayable(playable, open_frame_source(source), StyleDrawer(style))


def through_lens(
    options: LensOptions, path: Location, playable: Playable, frames: list[int], eyes: tuple[float, ...]
) -> tuple[Playable, ...]:
    """Return the scene as seen through the lens that the options describe, once for each eye. ``eyes`` are the
    distances of the eyes to the right of the camera, in world units; only panoramas depend on them.

    The mirror floor and an automatically placed glass ball are positioned relative to the subject's points in two of
    the rendered frames: the first and the middle one.
    """
    import numpy as np

    from fourd.cli.rendering.lens_options import make_inserts, make_lens
    from fourd.scene.meshes.source import is_mesh
    from fourd.viewer.playback.sources import open_frame_source
    from fourd.viewer.rendering.drawn_playable import DrawnPlayable, LensDrawer

    if isinstance(path, Path) and is_mesh(path):
        raise UserError(f"{path}: expected a run or a .4dv scene for --lens, got meshes")
    source = open_frame_source(path)
    views = list(playable.views.values())
    inserts: tuple[Insert, ...] = ()
    if options.mirror_floor or options.glass_ball is not None:
        chosen = sorted({frames[0], frames[len(frames) // 2]})
        read = [source.read(frame) for frame in chosen]
        subject = np.concatenate([frame.xyz[: frame.dynamic_count] for frame in read])
        inserts = make_inserts(options, views, subject)
    if not views:
        raise UserError(f"{path}: expected a scene with cameras for --lens, got none")
    lenses = [make_lens(options, views[0], playable.focus, eye) for eye in eyes]
    return tuple(DrawnPlayable(playable, source, LensDrawer(lens, inserts)) for lens in lenses)
