"""Synthetic videos of a moving calibration board, with the true calibration."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fourd.base.cameras import Camera, look_at
from fourd.base.errors import UserError
from fourd.base.files import atomic_path, remove_unfinished, write_text_atomically
from fourd.base.progress import Track
from fourd.recording.boards import CalibrationBoard, write_board
from fourd.recording.capture.calibration import write_calibration
from fourd.recording.synth.board_render import BoardPose, BoardRenderer, Optics

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

BOARD_NAME = "board.toml"
POSES_NAME = "board_poses.json"
SETTINGS_NAME = "synth_board.json"
VERSION = 1
FPS = 10
RADIUS_M = 1.7
"""Distance of the cameras from the centre of the board's motion, in metres."""
ARC_DEGREES = 110.0
"""Angle between the first and the last camera, measured at the centre of the board's motion, in degrees. All cameras
see the front of the board."""
REACH_M = 0.38
"""Amplitude of the board's motion along each axis, in metres."""
TILT_DEGREES = 35.0
"""Amplitude of the board's rotations, in degrees."""
EXPOSURE = 0.05
"""Exposure time as a fraction of the time between two frames. It determines the motion blur."""
EXPOSURE_SAMPLES = 3
BOARD = CalibrationBoard(7, 5, 0.08, 0.06, "DICT_4X4_50")
"""The default board."""


@dataclass(frozen=True)
class BoardSettings:
    """Settings of synthetic board videos.

    Attributes:
        frames: number of frames, 3 to 10000.
        cameras: number of cameras on an arc of 110 degrees, 2 to 100.
        size: width and height of the images in pixels, 128 to 4096.
        seed: seed of all random numbers: the lenses, the motion and the noise.
        board: kind and dimensions of the calibration board.
        optics: blur and noise.

    Raises:
        UserError: if a value is out of range.
    """

    frames: int = 60
    cameras: int = 4
    size: int = 640
    seed: int = 0
    board: CalibrationBoard = BOARD
    optics: Optics = Optics()  # noqa: RUF009

    def __post_init__(self) -> None:
        limits = {"frames": (3, 10_000), "cameras": (2, 100), "size": (128, 4096), "seed": (0, 2**63)}
        for name, (minimum, maximum) in limits.items():
            value = getattr(self, name)
            if not minimum <= value <= maximum:
                raise UserError(f"--{name}: expected {minimum} to {maximum} with --board, got {value}")


def make_board_videos(out: Path, settings: BoardSettings, track: Track) -> None:
    """Write videos/CAM.mp4, board.toml and truth/ (intri.yml, extri.yml, board_poses.json) into the folder ``out``.

    World units are metres, and +z points up. ``board_poses.json`` lists, for each frame, the rotation matrix and the
    translation from board to world coordinates.

    Raises:
        UserError: if ``out`` contains files but no synthetic board videos.
    """
    _prepare_folder(out)
    names = [f"cam{index:02d}" for index in range(settings.cameras)]
    cameras = rig_cameras(settings)
    content = {"version": VERSION, **asdict(settings)}
    write_text_atomically(out / SETTINGS_NAME, json.dumps(content, indent=1) + "\n")
    write_board(out / BOARD_NAME, settings.board)
    write_calibration(out / "truth", names, cameras, metres_per_unit=1.0)
    poses = [board_pose(settings, float(frame)) for frame in range(settings.frames)]
    rows = [{"rotation": pose.rotation.tolist(), "translation": pose.translation.tolist()} for pose in poses]
    write_text_atomically(out / "truth" / POSES_NAME, json.dumps(rows) + "\n")
    count = settings.frames * settings.cameras
    progress = iter(track(range(count), count, "synth"))
    for index, (name, camera) in enumerate(zip(names, cameras, strict=True)):
        with atomic_path(out / "videos" / f"{name}.mp4") as path:
            write_grey_video(path, _render_frames(settings, camera, index, progress), FPS)
    next(progress, None)


def rig_cameras(settings: BoardSettings) -> list[Camera]:
    """Return the cameras on an arc around the origin, at two heights. Each camera has a different lens."""
    generator = np.random.default_rng([settings.seed, 1])
    angles = np.radians(np.linspace(-ARC_DEGREES / 2, ARC_DEGREES / 2, settings.cameras))
    size, cameras = settings.size, []
    for index, angle in enumerate(angles):
        focal = 1.15 * size * (1 + generator.uniform(-0.06, 0.06))
        aspect = 1 + generator.uniform(-0.002, 0.002)
        centre = size / 2 + generator.uniform(-0.012, 0.012, 2) * size
        k = np.array([[focal, 0, centre[0]], [0, focal * aspect, centre[1]], [0, 0, 1]])
        distortion = generator.uniform((-0.2, -0.05, -1e-3, -1e-3, 0), (0.1, 0.08, 1e-3, 1e-3, 0.03))
        height = 0.5 if index % 2 else -0.1
        place = np.array([RADIUS_M * np.sin(angle), -RADIUS_M * np.cos(angle), height])
        camera = look_at(place, generator.uniform(-0.05, 0.05, 3), np.array([0.0, 0.0, 1.0]), k, size, size)
        cameras.append(replace(camera, distortion=distortion))
    return cameras


def board_pose(settings: BoardSettings, time: float) -> BoardPose:
    """Return the pose of the board at a ``time`` in frames. The board moves smoothly, and its front faces the middle of
    the cameras' arc."""
    rotations, translations = board_path(settings, np.array([time]))
    return BoardPose(rotations[0], translations[0])


def board_path(settings: BoardSettings, times: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the rotations (N, 3, 3) and the translations (N, 3) in metres of the board's poses at ``times`` (N,) in
    frames. See board_pose."""
    generator = np.random.default_rng([settings.seed, 2])
    phases, cycles = generator.uniform(0, 2 * np.pi, 6), generator.uniform(2.0, 5.0, 6)
    # Neither the speed of the board nor the motion blur depends on the number of frames.
    waves = np.sin(2 * np.pi * cycles * times[:, None] / 60 + phases)
    tilts = np.radians(TILT_DEGREES) * waves[:, 3:] * (1.0, 1.0, 1.5)
    # The base rotation makes the board upright: the x axis of the board points to the right, and its front faces the
    # direction -y.
    upright = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    rotations = np.asarray(upright @ Rotation.from_rotvec(tilts).as_matrix())
    middles = REACH_M * waves[:, :3] * (1.0, 0.8, 0.8)
    width, height = settings.board.size_m
    return rotations, middles - rotations @ (width / 2, height / 2, 0.0)


def write_grey_video(path: Path, pictures: Iterator[Picture], fps: int) -> None:
    """Encode grey images (H, W) uint8 as nearly lossless H.264 video, or as MPEG-4 if H.264 is not available."""
    encoder = "libx264" if "libx264" in av.codecs_available else "mpeg4"
    options = {"crf": "10", "preset": "veryfast", "threads": "1"} if encoder == "libx264" else {"qscale": "1"}
    with av.open(str(path), "w") as container:
        stream = container.add_stream(encoder, rate=fps, options=options)
        assert isinstance(stream, av.VideoStream)
        for number, picture in enumerate(pictures):
            if number == 0:
                stream.height, stream.width = picture.shape
                stream.pix_fmt = "yuv420p"
            frame = av.VideoFrame.from_ndarray(np.repeat(picture[..., None], 3, axis=2), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def _render_frames(settings: BoardSettings, camera: Camera, index: int, progress: Iterator[int]) -> Iterator[Picture]:
    renderer = BoardRenderer(settings.board, camera, settings.optics)
    offsets = np.linspace(-EXPOSURE / 2, EXPOSURE / 2, EXPOSURE_SAMPLES)
    for frame in range(settings.frames):
        next(progress, None)
        generator = np.random.default_rng([settings.seed, 3, index, frame])
        yield renderer.render([board_pose(settings, frame + float(offset)) for offset in offsets], generator)


def _prepare_folder(out: Path) -> None:
    """Create the folder ``out``. If it contains videos of an earlier call, remove them."""
    if out.exists() and not out.is_dir():
        raise UserError(f"{out}: expected a folder, got a file; name another folder")
    if out.is_dir() and any(out.iterdir()) and not (out / SETTINGS_NAME).is_file():
        raise UserError(
            f"{out}: expected an empty folder or synthetic board videos ({SETTINGS_NAME}), got other files; name "
            "another folder"
        )
    out.mkdir(parents=True, exist_ok=True)
    remove_unfinished(out, deep=True)
    for path in (out / "videos").glob("cam*.mp4"):
        path.unlink()
