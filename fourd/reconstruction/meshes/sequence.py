"""Makes the meshes of a whole capture: one file for each frame, and an animation.

Frames are processed one at a time, and an interrupted run can be resumed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from fourd.base.cameras import Array, estimate_up
from fourd.base.errors import UserError, command_line
from fourd.base.files import remove_unfinished, write_text_atomically
from fourd.base.formats.glb_animation import write_animation
from fourd.base.formats.glb_mesh import write_textured_glb
from fourd.base.formats.ply import write_ply
from fourd.base.limits import read_json
from fourd.base.progress import Track, untracked
from fourd.reconstruction.carving.bounds import hull_bounds
from fourd.reconstruction.carving.sequence import settings_key
from fourd.reconstruction.meshes.fitting.fit import fit_mesh
from fourd.reconstruction.meshes.fitting.hull_distance import hull_distance_grid
from fourd.reconstruction.meshes.settings import MeshSettings
from fourd.reconstruction.meshes.surface.components import drop_crumbs
from fourd.reconstruction.meshes.surface.remeshing import remesh
from fourd.reconstruction.meshes.texturing.texture import colour_mesh, texture_mesh
from fourd.reconstruction.meshes.views import mesh_views
from fourd.recording.capture import Capture
from fourd.recording.capture.layout import refuse_symlinks
from fourd.recording.capture.pictures.mask_source import frame_masks

STATE_NAME = "meshes.json"
ANIMATION_NAME = "animation.glb"
VERSION = 2
BOUNDS_MARGIN = 0.03
"""Margin of the box around a frame's hull, as a fraction of the box's longest side."""
DEFAULT_FPS = 30.0
"""Frame rate of the animation if the capture's frame rate is unknown."""


def mesh_capture(
    capture: Capture, folder: Path, settings: MeshSettings, track: Track = untracked, *, force: bool = False
) -> list[Path]:
    """Make one mesh for each frame of a capture. Write the files FRAME.glb and animation.glb, or FRAME.ply.

    FRAME is the six-digit number of the frame in the capture. Files are written atomically, and memory does not grow
    with the number of frames. If neither the capture nor the settings changed since the last call, finished meshes are
    kept.

    Args:
        capture: cameras, images and mattes, without held-out views.
        folder: output folder, created if missing.
        settings: settings of the grid, the texture and the fit.
        track: callback that reports progress.
        force: whether to replace meshes that were made from other files or with other settings.

    Returns:
        the frames' files, in temporal order.

    Raises:
        UserError: if the capture has no mattes, a frame's hull is empty, or a file cannot be written. Also if the
            folder has meshes that were made from other files or with other settings, without ``force``.
    """
    if not capture.has_masks:
        raise UserError(
            f"{capture.path}: expected masks/CAM/FRAME.png or mattes, got none; "
            f"make mattes with: {command_line('fourd', 'matte', capture.path)}"
        )
    refuse_symlinks(capture.path, folder)
    paths = [folder / f"{number:06d}.{settings.format}" for number in capture.frame_numbers]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_unfinished(folder)
        _remove_stale(folder, _key(capture, settings), settings, force)
        up = estimate_up(capture.cameras)
        for frame in track(range(len(paths)), len(paths), "meshes"):
            if not paths[frame].exists():
                _make_frame(capture, frame, paths[frame], settings, up)
        if settings.format == "glb" and not (folder / ANIMATION_NAME).exists():
            write_animation(folder / ANIMATION_NAME, paths, capture.fps or DEFAULT_FPS, up)
    except OSError as error:
        raise UserError(
            f"{folder}: expected a writable folder, got '{error.strerror}'; free disk space or choose another folder"
        ) from error
    return paths


def _make_frame(capture: Capture, frame: int, path: Path, settings: MeshSettings, up: Array) -> None:
    """Fit, texture and write the mesh of one frame."""
    masks = frame_masks(capture, frame)
    cameras, names = capture.cameras, capture.names
    label = f"{capture.path} frame {capture.frame_numbers[frame]}"
    agreement, least_views = settings.agreement, settings.least_views
    bounds = hull_bounds(masks, cameras, agreement=agreement, least_views=least_views, names=names, label=label).padded(
        BOUNDS_MARGIN
    )
    start = hull_distance_grid(
        masks,
        cameras,
        bounds,
        cells=settings.cells,
        agreement=agreement,
        least_views=least_views,
        trim=settings.trim,
        names=names,
        label=label,
    )
    views = mesh_views([capture.image(camera, frame) for camera in range(len(cameras))], masks, cameras)
    fitted = fit_mesh(start, views, settings.fit)
    xyz, triangles = drop_crumbs(fitted.xyz, fitted.triangles)
    if settings.remesh > 0:
        xyz, triangles = remesh(xyz, triangles, settings.remesh * start.grid.side)
    if settings.format == "ply":
        normals, rgb = colour_mesh(xyz, triangles, views)
        write_ply(path, xyz, rgb, normals, triangles)
    else:
        mesh = texture_mesh(xyz, triangles, views, settings.texture_size)
        write_textured_glb(path, mesh.xyz, mesh.normals, mesh.uv, mesh.texture, mesh.triangles, up)


def _key(capture: Capture, settings: MeshSettings) -> str:
    """Hash all inputs of the meshes: settings, frame rate, cameras, and the name, size and modification time of each
    input file."""
    return hashlib.sha256(f"{VERSION} {capture.fps} {settings_key(capture, settings)}".encode()).hexdigest()


def _remove_stale(folder: Path, key: str, settings: MeshSettings, force: bool) -> None:
    """Remove the meshes and the animation in ``folder`` if they were made with another key, and store the new key.

    Raises UserError if there are such meshes and ``force`` is false, or if fourd did not make them.
    """
    state = folder / STATE_NAME
    try:
        known = read_json(state)
    except (FileNotFoundError, ValueError):
        known = None
    if isinstance(known, dict) and known.get("key") == key:
        return
    patterns = ("[0-9]" * 6 + ".glb", "[0-9]" * 6 + ".ply", ANIMATION_NAME)
    found = sorted(path for pattern in patterns for path in folder.glob(pattern))
    if found and not isinstance(known, dict):
        raise UserError(
            f"{folder}: expected a new folder or meshes of fourd mesh, got other files such as {found[0].name}; name "
            "another folder"
        )
    values = _flat(asdict(settings))
    if found and not force:
        old = known.get("settings") if isinstance(known, dict) else None
        changes = _changes(old, values) if isinstance(old, dict) else []
        raise UserError(
            f"{folder}: expected meshes of these files and settings, got {len(found)} files that were made with others"
            f"{f' ({changes[0]})' if changes else ''}; name another folder, or add --force to replace them"
        )
    for path in found:
        path.unlink()
    content = {"version": VERSION, "key": key, "settings": values}
    write_text_atomically(state, json.dumps(content, indent=1) + "\n")


def _flat(values: Mapping[str, object]) -> dict[str, object]:
    """Join the names of nested settings by dots."""
    flat: dict[str, object] = {}
    for name, value in values.items():
        inner = _flat(value) if isinstance(value, dict) else {}
        flat |= {f"{name}.{key}": item for key, item in inner.items()} or {name: value}
    return flat


def _changes(old: Mapping[str, object], new: Mapping[str, object]) -> list[str]:
    """Describe the settings that differ, one text for each."""
    return [f"{name.replace('_', ' ')}: {old.get(name)} -> {new[name]}" for name in new if old.get(name) != new[name]]
