"""Generation of a synthetic capture in a dome: images with noise and each camera's own colours, and the truth."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.recording.capture.calibration import write_calibration
from fourd.recording.capture.frame_rate import DEFAULT_FPS, check_rate, standard_rate, write_rate
from fourd.recording.synth.dome.people import Cast, lap_angle, make_cast, pose_cast
from fourd.recording.synth.dome.rig import DomeCamera, make_rig, suggest_test_views, visible_fixtures
from fourd.recording.synth.dome.room import EmptyView, Room, make_room, render_room
from fourd.recording.synth.figure import Part
from fourd.recording.synth.folder import has_finished, prepare_folder, write_cameras, write_image, write_settings
from fourd.recording.synth.render import as_millimetres, as_uint8, composite_parts

Array = NDArray[np.float64]

RIG_NAME = "rig.json"
ASPECT = 9 / 16
BLUR_PX = 0.5
NOISE = 2.5
"""Standard deviation of the noise in grey levels at a grey value of 126. It grows with the square root of the
brightness."""
JPEG_QUALITY = 85


@dataclass(frozen=True)
class DomeSettings:
    """Settings of a synthetic capture in a dome, which determine every byte of it.

    Attributes:
        frames: number of frames, at least 1. They cover a whole number of laps of the walking person, of about 90
            frames each, so the capture can be played in a loop.
        cameras: number of cameras in the wall, 3 to 100.
        size: width of the images in pixels, 64 to 4096. The height is 9/16 of the width, rounded to an even number.
        seed: seed of all random numbers, at least 0.
        gloss: strength of the highlights on the people, 0 to 1.
        fps: frame rate of the capture in frames per second. It does not change the images.
        masks: whether the capture has masks. If not, they are written to truth/masks.

    Raises:
        UserError: if a value is out of range. The error message contains the name of the option.
    """

    frames: int = 24
    cameras: int = 20
    size: int = 320
    seed: int = 0
    gloss: float = 0.3
    fps: float = DEFAULT_FPS
    masks: bool = True

    def __post_init__(self) -> None:
        limits = {"frames": (1, 100_000), "cameras": (3, 100), "size": (64, 4096), "seed": (0, 2**63), "gloss": (0, 1)}
        check_rate(self.fps)
        for name, (minimum, maximum) in limits.items():
            value = getattr(self, name)
            if not minimum <= value <= maximum:
                raise UserError(
                    f"--{name}: expected {minimum} to {maximum} with --dome, got {value}; give a number in that range"
                )

    @property
    def height(self) -> int:
        """Height of the images in pixels."""
        return 2 * round(self.size * ASPECT / 2)

    def stored(self) -> dict[str, object]:
        """Return the content of synth.json."""
        return {"dome": True, **asdict(self)}


def make_dome(out: Path, settings: DomeSettings) -> None:
    """Write a synthetic capture of two people in a dome into the folder ``out``.

    The capture contains images/CAM/FRAME.jpg, masks/CAM/FRAME.png (soft mattes, 255 = people and ball), intri.yml,
    extri.yml, synth.json (the settings), and the truth: truth/depth/CAM/FRAME.png (uint16 camera depth of people and
    ball in millimetres at pixel centres, 0 = background), truth/bgs/CAM.png (the empty dome, without noise and in the
    camera's colours), truth/bg_depth/CAM.png (its depth) and truth/rig.json (gains and bodies of the cameras). The same
    settings give bit-identical files. A finished capture in ``out`` is kept if it has the same settings, and is
    replaced if it has other settings.

    Raises:
        UserError: if ``out`` contains files but no synthetic capture.
    """
    if is_finished(out, settings):
        return
    prepare_folder(out)
    write_settings(out, settings.stored(), finished=False)
    room, rig = _make_dome_rig(settings)
    write_calibration(out, [item.name for item in rig], [item.camera for item in rig], metres_per_unit=1.0)
    write_rate(out, standard_rate(settings.fps))
    _write_rig(out / "truth" / RIG_NAME, rig)
    cast = make_cast(settings.seed)
    write_cameras(
        [item.name for item in rig],
        settings.frames,
        lambda index, advance: _write_camera(out, room, rig, index, cast, settings, advance),
    )
    write_settings(out, settings.stored(), finished=True)


def is_finished(out: Path, settings: DomeSettings) -> bool:
    """Return whether ``out`` contains a finished capture with these settings."""
    return has_finished(out, settings.stored())


def suggested_test_views(settings: DomeSettings) -> list[str]:
    """Return the names of cameras that have neighbours on all sides, so that they suit held-out views."""
    return suggest_test_views(_make_dome_rig(settings)[1])


def record_colours(rgb: Array, gain: Array, generator: np.random.Generator) -> NDArray[np.uint8]:
    """Convert the light (H, W, 3) that reaches a camera to the colours that the camera records, with blur and noise."""
    light = cv2.GaussianBlur(np.clip(rgb * gain, 0, 1), (0, 0), BLUR_PX)
    noise = generator.normal(size=light.shape) * NOISE / 255 * np.sqrt(0.3 + light * 255 / 180)
    return as_uint8(light + noise)


def _make_dome_rig(settings: DomeSettings) -> tuple[Room, list[DomeCamera]]:
    room = make_room(np.random.default_rng([settings.seed, 12]))
    generator = np.random.default_rng([settings.seed, 13])
    return room, make_rig(room, settings.cameras, settings.size, settings.height, generator)


def _write_rig(path: Path, rig: Sequence[DomeCamera]) -> None:
    rows = {}
    for item in rig:
        (back, _), (front, _) = item.body[0].spheres()
        rows[item.name] = {
            "gain": item.gain.tolist(),
            "body": {"back": back.tolist(), "front": front.tolist(), "radii": list(item.body[0].radii)},
        }
    write_text_atomically(path, json.dumps({"version": 1, "cameras": rows}, indent=1) + "\n")


def _write_camera(
    out: Path,
    room: Room,
    rig: Sequence[DomeCamera],
    index: int,
    cast: Cast,
    settings: DomeSettings,
    advance: Callable[[], None],
) -> None:
    """Write the empty dome and all frames of one camera."""
    item = rig[index]
    view = _render_empty(room, rig, index)
    write_image(out / "truth" / "bgs" / f"{item.name}.png", as_uint8(view.rgb * item.gain)[..., ::-1])
    write_image(out / "truth" / "bg_depth" / f"{item.name}.png", as_millimetres(view.depth))
    masks = out / "masks" if settings.masks else out / "truth" / "masks"
    for frame in range(settings.frames):
        moment = pose_cast(cast, lap_angle(frame, settings.frames))
        plate = view.rgb * (1 - _shadows(moment.feet, item.camera, view))[..., None]
        # People are always in front of camera bodies and boxes, which are close to the wall.
        rgb, coverage, depth = composite_parts(moment.parts, item.camera, plate, settings.gloss)
        stem = f"{item.name}/{frame:06d}"
        picture = record_colours(rgb, item.gain, np.random.default_rng([settings.seed, 14, index, frame]))
        write_image(out / "images" / f"{stem}.jpg", picture[..., ::-1], JPEG_QUALITY)
        write_image(masks / f"{stem}.png", as_uint8(coverage))
        write_image(out / "truth" / "depth" / f"{stem}.png", as_millimetres(depth))
        advance()


def _render_empty(room: Room, rig: Sequence[DomeCamera], index: int) -> EmptyView:
    """Render the dome without people, as seen by the camera ``index``. The camera looks out of its own body, which is
    therefore not visible."""
    camera = rig[index].camera
    view = render_room(room, camera)
    rgb, coverage, depth = composite_parts(visible_fixtures(rig, index), camera, view.rgb, 0.1)
    return EmptyView(rgb, np.where(depth > 0, depth, view.depth), view.floor * (1 - coverage))


def _shadows(feet: Sequence[Part], camera: Camera, view: EmptyView) -> Array:
    """Return the share (H, W) of light that soft shadows of the feet remove from each pixel. Shadows fall on the floor
    alone, and disappear as a foot is lifted."""
    shade = np.zeros(view.depth.shape)
    i, j = np.nonzero(view.floor)
    if len(i) == 0:
        return shade
    xyz = camera.unproject(np.column_stack([j + 0.5, i + 0.5]), view.depth[i, j])
    light = np.ones(len(i))
    for foot in feet:
        for centre, _ in foot.spheres():
            distance = np.square(xyz[:, :2] - centre[:2]).sum(axis=1)
            contact = np.exp(-max(centre[2] - 0.05, 0) / 0.1)
            light *= 1 - 0.4 * contact * np.exp(-distance / (2 * 0.09**2))
            light *= 1 - 0.07 * np.exp(-distance / (2 * 0.3**2))
    shade[i, j] = (1 - light) * view.floor[i, j]
    return shade
