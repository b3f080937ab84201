"""The factors of a rig one by one: each does what its strength says, and nothing at strength 0."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.recording.capture.video import VideoReader, index_video
from fourd.recording.synth.dome.people import lowest_height
from fourd.recording.synth.figure import make_figure
from fourd.recording.synth.generate import SynthSettings, ring_cameras
from fourd.recording.synth.rig.calibration import CENTRE_PX, FOCAL, POSITION, ROTATION_DEG, disturb, draw_error
from fourd.recording.synth.rig.camera import draw_camera, expose, record
from fourd.recording.synth.rig.people import PATH_RADIUS_M, draw_walkers, make_stage, pose_walker, render_walkers
from fourd.recording.synth.rig.settings import FACTORS, USUAL, RigSettings, parse_factors
from fourd.recording.synth.rig.shutter import Shutter, row_weights
from fourd.recording.synth.rig.sources import Moment
from fourd.recording.synth.rig.video import check_video, write_video
from tests.captures import ring_cameras as tilted_ring

Array = NDArray[np.float64]


def _recorded(light: Array, settings: RigSettings, index: int = 0) -> Array:
    camera = draw_camera(settings, index, 1.0)
    return record(camera, Moment(light, None), 0)[0].astype(np.float64)


def _edge(sigma_px: float) -> Array:
    """A dark and a bright half, after a blur of the given strength."""
    light = np.full((32, 32, 3), 40.0)
    light[:, 16:] = 200
    camera = replace(draw_camera(RigSettings(), 0, 1.0), blur_px=sigma_px)
    return record(camera, Moment(light, None), 0)[0].astype(np.float64)


def test_without_factors_nothing_changes() -> None:
    """Catches a factor that acts at strength 0."""
    light = np.random.default_rng(0).integers(0, 256, (20, 30, 3)).astype(np.float64)
    for index in range(5):
        assert np.array_equal(_recorded(light, RigSettings(), index), light)
    camera = tilted_ring(4, 64)[0]
    same = disturb(camera, draw_error(0, 2.0, np.random.default_rng(1)))
    assert np.array_equal(same.rotation, camera.rotation)
    assert np.array_equal(same.intrinsics, camera.intrinsics)
    assert np.allclose(same.translation, camera.translation, atol=1e-14)
    assert list(row_weights(Shutter(), 3, 8, 16)) == [48]


@pytest.mark.parametrize("name", ["exposure", "white-balance"])
def test_gains_multiply_the_colours_by_what_the_truth_says(name: str) -> None:
    """Catches gains in the wrong channel, gains that are the same in all cameras, and a wrong spread."""
    settings = parse_factors([name])
    light = np.full((8, 8, 3), 100.0)
    gains = np.array([draw_camera(settings, index, 1.0).gain for index in range(300)])
    for index in range(3):
        assert np.abs(_recorded(light, settings, index).mean(axis=(0, 1)) / 100 - gains[index]).max() < 0.006
    logs = np.log(gains)
    if name == "exposure":
        assert np.allclose(gains, gains[:, :1])
        assert logs[:, 0].std() == pytest.approx(USUAL.exposure, rel=0.15)
    else:
        assert logs.std(axis=0) == pytest.approx(np.full(3, USUAL.white_balance), rel=0.15)
        assert abs(np.corrcoef(logs[:, 0], logs[:, 2])[0, 1]) < 0.2


def test_vignetting_takes_its_share_in_the_corners_and_nothing_in_the_middle() -> None:
    """Catches a falloff about the corner of the image, or one that reaches its strength at the edges of a wide
    image."""
    settings = parse_factors(["vignetting=0.3"])
    falloff = draw_camera(settings, 2, 1.0).falloff
    recorded = _recorded(np.full((90, 160, 3), 200.0), settings, 2)[..., 0] / 200
    corners = recorded[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert corners == pytest.approx(np.full(4, 1 - falloff), abs=0.01)
    assert recorded[45, 80] == pytest.approx(1, abs=0.004)
    assert recorded[45, 0] == pytest.approx(1 - falloff * 160**2 / (160**2 + 90**2), abs=0.01)
    assert np.mean([draw_camera(settings, index, 1.0).falloff for index in range(200)]) == pytest.approx(0.3, abs=0.01)


def test_noise_has_the_variance_of_its_model() -> None:
    """Catches noise whose variance does not grow with the light, and noise that channels, cameras or frames share."""
    settings = parse_factors(["noise=4"])
    for grey in (20.0, 126.0, 200.0):
        recorded = _recorded(np.full((200, 200, 3), grey), settings)
        expected = 16 * (0.3 + 0.7 * grey / 126) + 1 / 12  # rounding to whole levels adds 1/12
        assert recorded.var(axis=(0, 1)) == pytest.approx(np.full(3, expected), rel=0.04)
        assert recorded.mean() == pytest.approx(grey, abs=0.1)
        assert abs(np.corrcoef(recorded[..., 0].ravel(), recorded[..., 1].ravel())[0, 1]) < 0.03
    light = np.full((40, 40, 3), 126.0)
    camera = draw_camera(settings, 0, 1.0)
    first, second = (record(camera, Moment(light, None), frame)[0].astype(float) for frame in (0, 1))
    assert (first - second).std() == pytest.approx(4 * 2**0.5, rel=0.05)
    assert not np.array_equal(first, _recorded(light, settings, 1))


@pytest.mark.parametrize("sigma_px", [0.6, 1.5, 3.0])
def test_blur_spreads_an_edge_by_its_standard_deviation(sigma_px: float) -> None:
    """Catches a blur whose strength is a radius or a kernel's width: the slope of an edge has the variance of the blur,
    beside that of a pixel, 1/12."""
    profile = _edge(sigma_px)[16, :, 0]
    slope, place = np.diff(profile) / 160, np.arange(31) - 15.0
    assert slope.sum() == pytest.approx(1)
    assert np.sqrt((slope * place**2).sum()) == pytest.approx(sigma_px, rel=0.06)


def test_the_matte_is_blurred_like_the_picture() -> None:
    """Catches true mattes that are sharper than the recorded images."""
    matte = np.zeros((32, 32))
    matte[:, 16:] = 1
    camera = replace(draw_camera(RigSettings(), 0, 1.0), blur_px=1.5)
    light = np.repeat(255 * matte[..., None], 3, axis=2)
    picture, recorded = record(camera, Moment(light, matte), 0)
    assert recorded is not None
    assert np.array_equal(picture[..., 0], recorded)


def _column_of_ramp(shutter: Shutter, knots_per_frame: int) -> Array:
    """The time in frames at which each row of frame 2 is exposed on average: the picture's grey level is the time."""

    def moment(knot: int) -> Moment:
        return Moment(np.full((40, 4, 3), knot / knots_per_frame), None)

    rgb = expose(row_weights(shutter, 2, 40, knots_per_frame), moment).rgb
    assert rgb.shape == (40, 4, 3)
    return np.asarray(rgb[:, 0, 0])


@pytest.mark.parametrize("knots_per_frame", [1, 16])
def test_rows_are_exposed_at_the_times_of_the_shutter(knots_per_frame: int) -> None:
    """Catches a rolling shutter that runs upwards or delays the whole image, and an offset of the wrong sign."""
    assert _column_of_ramp(Shutter(), knots_per_frame) == pytest.approx(np.full(40, 2.0))
    assert _column_of_ramp(Shutter(offset=0.23), knots_per_frame) == pytest.approx(np.full(40, 2.23))
    rolled = _column_of_ramp(Shutter(offset=-0.1, readout=0.4), knots_per_frame)
    assert rolled == pytest.approx(1.9 + 0.4 * ((np.arange(40) + 0.5) / 40 - 0.5))
    blurred = _column_of_ramp(Shutter(offset=0.05, readout=0.3, exposure=0.5), knots_per_frame)
    assert blurred == pytest.approx(2.05 + 0.3 * ((np.arange(40) + 0.5) / 40 - 0.5))


def test_rolling_shutter_skews_a_moving_edge() -> None:
    """Catches rows that are all exposed at once: an edge that moves by 20 px per frame leans by 20 px times the
    readout."""

    def moment(knot: int) -> Moment:
        edge = 30 + 20 * knot / 16
        row = np.clip(np.arange(100) + 0.5 - edge + 0.5, 0, 1)
        return Moment(255 * np.repeat(np.tile(row, (50, 1))[..., None], 3, axis=2), None)

    rgb = expose(row_weights(Shutter(readout=0.5), 1, 50, 16), moment).rgb[..., 0]
    edges = 100 - rgb.sum(axis=1) / 255
    assert edges[-1] - edges[0] == pytest.approx(20 * 0.5 * 49 / 50, abs=0.05)
    assert edges.mean() == pytest.approx(edges[24:26].mean(), abs=0.01)


def test_motion_blur_smears_a_moving_edge_over_the_exposure() -> None:
    """Catches a shutter that is open for another time: an edge that moves by 16 px per frame is smeared over 16 px
    times the exposure, with the variance of a uniform distribution."""

    def moment(knot: int) -> Moment:
        row = (np.arange(100) >= 30 + knot).astype(float)
        return Moment(np.repeat(np.tile(row, (4, 1))[..., None], 3, axis=2), None)

    rgb = expose(row_weights(Shutter(exposure=0.75), 2, 4, 16), moment).rgb[0, :, 0]
    slope, place = np.diff(rgb), np.arange(1, 100)
    mean = (slope * place).sum()
    assert mean == pytest.approx(62, abs=0.01)
    # The scene is linear between knots, which adds the variance of a hat function, 1/6.
    assert (slope * (place - mean) ** 2).sum() == pytest.approx(12**2 / 12 + 1 / 6, rel=0.01)


def test_offsets_are_uniform_up_to_the_strength() -> None:
    """Catches offsets of one sign, or beyond the strength."""
    offsets = [draw_camera(parse_factors(["offset"]), index, 1.0).shutter.offset for index in range(300)]
    assert np.abs(offsets).max() <= USUAL.offset
    assert np.std(offsets) == pytest.approx(USUAL.offset / 3**0.5, rel=0.1)
    assert abs(np.mean(offsets)) < 0.03


def test_calibration_errors_have_the_usual_size() -> None:
    """Catches errors in radians, errors of the translation instead of the position, and wrong factors."""
    camera = tilted_ring(3, 200)[1]
    rows = []
    for index in range(400):
        wrong = disturb(camera, draw_camera(parse_factors(["calibration=2"]), index, 5.0).error)
        angle = np.degrees(np.arccos(np.clip((np.trace(wrong.rotation @ camera.rotation.T) - 1) / 2, -1, 1)))
        shift = wrong.intrinsics[:2, 2] - camera.intrinsics[:2, 2]
        focal = wrong.intrinsics[0, 0] / camera.intrinsics[0, 0] - 1
        rows.append([angle**2 / 3, *(wrong.centre - camera.centre) ** 2, *shift**2, focal**2])
    measured = np.sqrt(np.mean(rows, axis=0))
    position = 2 * POSITION * 5.0
    expected = [2 * ROTATION_DEG, *[position] * 3, *[2 * CENTRE_PX] * 2, 2 * FOCAL]
    assert measured == pytest.approx(expected, rel=0.12)


def test_people_walk_outside_the_ring_on_the_floor() -> None:
    """Catches people between the cameras and the subject, in the air, or who stand still."""
    cameras = ring_cameras(make_figure(0), SynthSettings(cameras=6, size=64))
    stage = make_stage(cameras)
    assert stage.metre == pytest.approx(1, abs=0.05)
    walkers = draw_walkers(3, cameras, stage, np.random.default_rng(0))
    places = []
    for seconds in (0.0, 0.5):
        poses = [pose_walker(walker, seconds) for walker in walkers]
        assert [lowest_height(parts) for parts in poses] == pytest.approx([0] * 3, abs=0.01)
        origins = [np.mean([part.origin for part in parts], axis=0) for parts in poses]
        assert np.linalg.norm([origin[:2] for origin in origins], axis=1) == pytest.approx([PATH_RADIUS_M] * 3, abs=0.2)
        places.append(origins)
    assert np.linalg.norm(np.subtract(*places), axis=1) == pytest.approx([0.65] * 3, abs=0.1)
    coverages = [render_walkers(walkers, stage.camera(camera), 0.0).coverage.mean() for camera in cameras]
    assert max(coverages) > 0.01


def test_people_are_where_cameras_on_one_side_look() -> None:
    """Catches people behind the cameras of a rig that is no ring, whom nobody sees."""
    cameras = ring_cameras(make_figure(0), SynthSettings(cameras=16, size=48))[:4]
    stage = make_stage(cameras)
    walkers = draw_walkers(3, cameras, stage, np.random.default_rng(5))
    assert all(render_walkers(walkers, stage.camera(camera), 0.2).coverage.mean() > 0.01 for camera in cameras)


@pytest.mark.parametrize("codec", ["h264", "hevc"])
def test_videos_have_the_frames_colours_and_rate(codec: str, tmp_path: Path) -> None:
    """Catches exchanged channels, a wrong range of the colours, lost frames, another frame rate, and a quality that the
    strength does not change."""
    texture = np.random.default_rng(0).integers(60, 190, (16, 24, 3)).repeat(4, axis=0).repeat(4, axis=1)
    pictures = [np.roll(texture, 2 * shift, axis=1).astype(np.uint8) for shift in range(6)]
    sizes, errors = [], []
    for strength in (12, 35):
        settings = RigSettings(video=strength, codec=codec)  # type: ignore[arg-type]
        path = tmp_path / f"{strength}.mp4"
        write_video(path, pictures, (96, 64), Fraction(25), settings)
        index = index_video(path)
        assert index.frames == 6
        assert index.fps == 25
        with VideoReader(path, index) as reader:
            frames = [reader.read(number).astype(float) for number in range(6)]
        assert np.mean([frame.mean(axis=(0, 1)) for frame in frames], axis=0) == pytest.approx(
            np.mean(texture, axis=(0, 1)), abs=3
        )
        sizes.append(path.stat().st_size)
        errors.append(np.mean([(frame - picture) ** 2 for frame, picture in zip(frames, pictures, strict=True)]))
    assert sizes[1] < 0.6 * sizes[0]
    assert errors[1] > errors[0]


def test_the_bit_rate_is_met(tmp_path: Path) -> None:
    """Catches a bit rate that is ignored."""
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 256, (96, 96, 3)).astype(np.uint8) for _ in range(30)]
    for mbps in (0.3, 1.5):
        path = tmp_path / f"{mbps}.mp4"
        write_video(path, pictures, (96, 96), Fraction(30), RigSettings(video=23, mbps=mbps))
        assert path.stat().st_size * 8 / 1e6 == pytest.approx(mbps, rel=0.35)


def test_odd_sizes_are_refused_before_encoding() -> None:
    """Catches an error of the encoder in place of a reason."""
    check_video("h264", 64, 48)
    with pytest.raises(UserError, match=r"video: expected images with an even width and height, got 63 x 48"):
        check_video("h264", 63, 48)


def test_a_factor_alone_is_the_same_as_among_others() -> None:
    """Catches draws that depend on which other factors are on, so that a table of single factors does not explain the
    whole."""
    whole = draw_camera(parse_factors(["all"], seed=3), 4, 2.0)
    assert np.array_equal(draw_camera(parse_factors(["vignetting,noise"], seed=3), 4, 2.0).falloff, whole.falloff)
    assert draw_camera(parse_factors(["offset"], seed=3), 4, 2.0).shutter.offset == whole.shutter.offset
    alone = draw_camera(parse_factors(["calibration"], seed=3), 4, 2.0).error
    assert alone.stored() == whole.error.stored()
    assert draw_camera(parse_factors(["calibration"], seed=4), 4, 2.0).error.stored() != alone.stored()


def test_names_select_factors() -> None:
    """Catches a name without an effect, and a value that is not used."""
    off = RigSettings()
    for name in FACTORS:
        field = name.replace("-", "_")
        assert getattr(off, field) == 0
        assert parse_factors([name]) == replace(off, **{field: getattr(USUAL, field)})
        assert parse_factors(["all", f"{name}=0"]) == replace(USUAL, **{field: 0})
    assert parse_factors([]) == parse_factors(["all"]) == USUAL
    assert parse_factors(["noise=5,blur", "offset=0.1"]) == RigSettings(noise=5, blur=USUAL.blur, offset=0.1)
