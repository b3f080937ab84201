"""Exports the frames of a scene in the file formats of other programs, one file for each frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import estimate_up
from fourd.base.errors import UserError
from fourd.base.formats.ply import write_ply
from fourd.base.progress import Track, untracked
from fourd.recording.capture.layout import sample_indices
from fourd.scene.colour_fit import viewpoints
from fourd.scene.exporting import usd
from fourd.scene.exporting.dgs import DgsExport, write_dgs
from fourd.scene.exporting.format import Format
from fourd.scene.exporting.gltf import write_splat_glb
from fourd.scene.playable import PlayableScene, selected_rate
from fourd.scene.rendering import Scene, render_frame
from fourd.scene.scene import SceneManifest
from fourd.scene.splats.cloud import SplatCloud, rotate_cloud
from fourd.scene.splats.dgs_writer import require_fourdgs
from fourd.scene.splats.frames import SPLAT_SH_BASE, SPLAT_SH_RANGE, SplatFit, frame_from_splats
from fourd.scene.splats.ply import write_splat_ply
from fourd.scene.splats.raw import write_splat
from fourd.scene.splats.spz import require_gsply, write_spz

FORMATS: tuple[Format, ...] = get_args(Format)
SUFFIXES: dict[Format, str] = {
    "ply-sequence": ".ply",
    "splat": ".splat",
    "spz": ".spz",
    "glb": ".glb",
    "usd": ".usdc",
    "4dgs": ".4dgs",
    "ply": ".ply",
}
Y_UP: tuple[Format, ...] = ("spz", "glb", "usd", "4dgs")
"""File formats in which the up direction is +y. In the other formats of Gaussian splats, it is -y. The format "ply",
which stores coloured points, keeps the scene's axes."""
OTHER_FILES = frozenset(
    {*SUFFIXES.values(), *usd.SUFFIXES, ".usdz", ".gltf", ".sog", ".ksplat", ".4dv", ".obj", ".zip"}
)
"""Suffixes of files. A folder with such a name would look like a file of another format."""
MEASURED_VIEWS, MEASURED_FRAMES = 4, 3
"""Maximum numbers of viewpoints and of frames for which the PSNR of an export is measured."""


@dataclass(frozen=True)
class ExportSettings:
    """Settings of an export.

    Attributes:
        format: "ply-sequence": Gaussian splats in the PLY files of 3D Gaussian Splatting. "splat", "spz", "glb",
            "usd" and "4dgs": Gaussian splats in these formats. "ply": coloured points.
        frames: 0-based indices of the frames.
        degree: largest degree of the spherical harmonics, 0 to 3. The formats "splat" and "ply" can only store degree
            0.
        keep_axes: whether the files keep the scene's axes. If false, the scene is rotated to the format's up direction:
            +y for the formats in :data:`Y_UP`, and -y for the other splat formats. The format "ply" always keeps the
            axes.
    """

    format: Format
    frames: Sequence[int]
    degree: int = 2
    keep_axes: bool = False


@dataclass(frozen=True)
class ExportReport:
    """Result of an export.

    Attributes:
        files: the written files, one for each frame. For several frames of "usd", the last file is the additional file
            that plays the frames. "4dgs" is one file with all frames.
        bytes_per_frame: mean size of a frame in bytes.
        psnr: PSNR in dB of renderings with the exported colours against renderings with the scene's colours, averaged
            over the measured images. Both are rendered by fourd from the capture's cameras and from cameras between
            neighbouring ones, and compared in the pixels that show the scene. None if no image shows a point.
    """

    files: tuple[Path, ...]
    bytes_per_frame: float
    psnr: float | None


def export_scene(scene: Scene, out: Path, settings: ExportSettings, track: Track = untracked) -> ExportReport:
    """Write frames of a scene, one at a time. Each file is written atomically.

    The shadows of a whole scene are part of the background's colours, which "4dgs" stores once, without shadows.

    Args:
        out: see :func:`list_files`.

    Raises:
        UserError: if ``out`` is not valid, a file cannot be written, or the package for the format is not installed.
    """
    _require_packages(settings.format, out)
    manifest = scene.manifest
    files = list_files(out, settings, manifest)
    fit = SplatFit(manifest, 0 if settings.format in ("splat", "ply") else settings.degree)
    rotation, unit = _rotation(manifest, settings), manifest.metres_per_unit or 1.0
    rate = selected_rate(PlayableScene(scene), settings.frames)
    loss = _LossMeter(manifest, settings.frames)
    if settings.format == "4dgs":
        axes = rotation, not settings.keep_axes
        write_dgs(out, scene, fit, DgsExport(settings.frames, rate, settings.degree, *axes, loss.measure), track)
        return ExportReport((out,), out.stat().st_size / max(len(settings.frames), 1), loss.psnr)
    for position, index in enumerate(track(settings.frames, len(settings.frames), "export")):
        frame = scene.frame(index)
        cloud = fit.convert(frame)
        loss.measure(scene, index, cloud)
        if rotation is not None:
            cloud = rotate_cloud(cloud, rotation)
        _write(files[position], cloud, settings.format, None if files == [out] else position, unit)
    size = sum(file.stat().st_size for file in files) / max(len(files), 1)
    if settings.format == "usd" and files != [out]:
        player = out if _is_file_name(out, "usd") else out / usd.SCENE
        names = [file.relative_to(player.parent).as_posix() for file in files]
        usd.write_usd_scene(player, names, settings.degree, rate, unit)
        files.append(player)
    return ExportReport(tuple(files), size, loss.psnr)


def list_files(out: Path, settings: ExportSettings, manifest: SceneManifest) -> list[Path]:
    """Return the files of the frames.

    If ``out`` has a suffix of the format, it is the file of the only frame. In a folder ``out``, each file name ends in
    the frame's number in the capture, so that other programs recognise the sequence. Several frames of USD are in the
    folder ``out/frames``, beside ``out/scene.usda``; if ``out`` has a suffix of USD, it is the scene file, and the
    frames of ``walk.usda`` are in the folder ``walk_frames``.

    Raises:
        UserError: if ``out`` has the suffix of another kind of file, or the format's suffix and there are several
            frames in a format without a scene file.
    """
    kind, count = settings.format, len(settings.frames)
    folder = out / "frames" if kind == "usd" else out
    if kind == "4dgs" and not _is_file_name(out, kind):
        raise UserError(f"{out}: expected a file .4dgs for --to 4dgs, got another name; change -o")
    if _is_file_name(out, kind):
        if count == 1 or kind == "4dgs":
            return [out]
        if kind != "usd":
            raise UserError(
                f"{out}: expected a folder for {count} frames, got the name of a file; "
                "name a folder, or choose one frame with --frames"
            )
        folder = out.with_name(f"{out.stem}_frames")
    elif out.suffix.lower() in OTHER_FILES and not out.is_dir():
        raise UserError(
            f"{out}: expected a folder or a file {SUFFIXES[kind]} for --to {kind}, got {out.suffix}; name another path"
        )
    suffix = SUFFIXES[kind]
    return [folder / f"frame_{manifest.frame_numbers[index]:06d}{suffix}" for index in settings.frames]


def _is_file_name(out: Path, kind: Format) -> bool:
    """Return whether ``out`` names a file of the format, not a folder."""
    return out.suffix.lower() in (usd.SUFFIXES if kind == "usd" else (SUFFIXES[kind],)) and not out.is_dir()


def _require_packages(kind: Format, out: Path) -> None:
    if kind == "spz":
        require_gsply(out)
    if kind == "usd":
        usd.require_usd(out)
    if kind == "4dgs":
        require_fourdgs(out)


def _write(path: Path, cloud: SplatCloud, kind: Format, time: int | None, metres_per_unit: float) -> None:
    writers: dict[Format, Callable[[Path, SplatCloud], None]] = {
        "ply-sequence": write_splat_ply,
        "splat": write_splat,
        "spz": write_spz,
        "glb": write_splat_glb,
        "ply": _write_points,
    }
    if kind == "usd":
        usd.write_splat_usd(path, cloud, time, metres_per_unit)
    else:
        writers[kind](path, cloud)


def _write_points(path: Path, cloud: SplatCloud) -> None:
    write_ply(path, cloud.xyz, np.rint(cloud.base_colour * 255).astype(np.uint8))


def _rotation(manifest: SceneManifest, settings: ExportSettings) -> NDArray[np.float64] | None:
    """Return the rotation (3, 3) from the scene's axes to those of the format, or None if no rotation is needed."""
    from scipy.spatial.transform import Rotation

    if settings.keep_axes or settings.format == "ply" or not manifest.cameras:
        return None
    target = np.array([0.0, 1.0 if settings.format in Y_UP else -1.0, 0.0])
    up = estimate_up(manifest.cameras)
    if np.allclose(up, target, atol=1e-9):
        return None
    return np.asarray(Rotation.align_vectors([target], [up])[0].as_matrix())


class _LossMeter:
    """Measures the PSNR of exported colours against the scene's original colours, for some frames and viewpoints."""

    def __init__(self, manifest: SceneManifest, frames: Sequence[int]) -> None:
        self._manifest = replace(
            manifest,
            source_names=(),
            source_cameras=(),
            other_names=(),
            other_cameras=(),
            sh_base=SPLAT_SH_BASE,
            sh_range=SPLAT_SH_RANGE,
        )
        cameras = viewpoints(manifest)
        self._cameras = [cameras[index] for index in sample_indices(len(cameras), MEASURED_VIEWS)]
        self._frames = {frames[index] for index in sample_indices(len(frames), MEASURED_FRAMES)}
        self._values: list[float] = []

    @property
    def psnr(self) -> float | None:
        """Mean PSNR in dB over the measured images; None if no image shows a point."""
        return float(np.mean(self._values)) if self._values else None

    def measure(self, scene: Scene, index: int, cloud: SplatCloud) -> None:
        """Measure frame ``index`` if it is one of the frames to measure. ``cloud`` must have the scene's axes."""
        if index not in self._frames:
            return
        frame = frame_from_splats(cloud)
        for camera in self._cameras:
            given = scene.render(camera, index)
            seen = given.alpha > 0.5
            if seen.any():
                exported = render_frame(frame, camera, self._manifest).rgb
                error = float(np.square(given.rgb[seen] - exported[seen]).mean())
                self._values.append(-10 * float(np.log10(max(error, 1e-10))))
