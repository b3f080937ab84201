"""Packed scenes of the tier "video": colours that are sampled from images, and damaged images."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
import zstandard
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.scene import BakedFrame, SceneReader, SceneWriter
from fourd.scene.packed.colours import mean_colours
from fourd.scene.packed.images import HEADER, bilinear, decode_image, project
from fourd.scene.packed.streams import StreamError
from fourd.scene.packing.images import choose_scale, fit_plane, make_image
from fourd.scene.packing.pack import pack_scene
from fourd.scene.packing.precision import LEVELS
from tests.baking.packing.test_pack import natural_frame
from tests.baking.scenes import manifest, ring, write_full_scene
from tests.baking.test_container import rewritten, with_manifest

MEMBER = "frames/000000/views/002"
Change = Callable[[bytes], bytes]


def smooth_frame(points: int, views: int, rng: np.random.Generator) -> BakedFrame:
    """Return a sphere whose colours differ smoothly from view to view, as reflections do."""
    frame = natural_frame(points, views, rng)
    normal = frame.xyz / 0.4
    phase = 3 * normal[:, None, :] + np.arange(views)[None, :, None]
    rgb = np.clip(128 + 60 * normal[:, None] + 40 * np.sin(phase), 0, 255)
    centres = np.stack([camera.centre for camera in ring(views)])
    cosine = normal @ (centres / np.linalg.norm(centres, axis=1, keepdims=True)).T
    weights = np.where(cosine > 0.2, 10 * cosine, 0).astype(np.float16)
    return replace(frame, rgb=rgb.astype(np.uint8), blend_weights=weights)


@pytest.fixture
def packed(tmp_path: Path, rng: np.random.Generator) -> Path:
    """A scene of the tier "video" with two frames."""
    cameras = ring(7, size=240)
    described = replace(manifest(6, 2), source_cameras=cameras[:6], other_cameras=cameras[6:])
    with SceneWriter(tmp_path / "scene.4dv", described) as writer:
        writer.add_frame(0, smooth_frame(2000, 6, rng))
        writer.add_frame(1, smooth_frame(500, 6, rng))
    pack_scene(tmp_path / "scene.4dv", tmp_path / "packed.4dv", "video", level=0)
    return tmp_path / "packed.4dv"


def nearest(old: BakedFrame, new: BakedFrame) -> NDArray[np.int64]:
    """Return for each point of ``new`` the index of the same point of ``old``. No two points have the same index, also
    where rounded positions are nearer to a neighbour."""
    distances = np.square(new.xyz[:, None] - old.xyz[None]).sum(axis=2)
    return np.asarray(linear_sum_assignment(distances)[1])


def test_sampled_colours_are_near_the_exact_ones(packed: Path) -> None:
    """Catches an image of the wrong view, a shifted or flipped image, and a wrong conversion of colours."""
    old, new = SceneReader(packed.with_name("scene.4dv")).read(0), SceneReader(packed).read(0)
    same = nearest(old, new)
    exact, weights = old.rgb[same].astype(float), new.blend_weights
    np.testing.assert_array_equal(weights > 0, old.blend_weights[same] > 0)
    seen = weights > 0
    error = np.sqrt(np.square(new.rgb - exact)[seen].mean(axis=0))
    without = np.sqrt(np.square(mean_colours(old)[same][:, None] - exact)[seen].mean(axis=0))
    assert np.all(error < 0.45 * without), (error, without)
    assert np.all(error < 10), error
    # Points that a view does not see have their mean colour in this view.
    unseen = np.flatnonzero(~seen.all(axis=1) & seen.any(axis=1))
    for point in unseen[:50]:
        colours = new.rgb[point][~seen[point]]
        assert np.abs(colours - mean_colours(old)[same[point]].astype(float)).max() <= 4


def test_planes_are_sampled_between_texel_centres() -> None:
    """Catches a shift by half a texel, which blurs and moves all colours, and reads beyond the border."""
    plane = np.array([[0, 10, 20], [100, 110, 120]], np.uint8)
    x = np.array([0.5, 1.5, 1.0, 1.0, -9, 99, np.nan, np.inf], np.float32)
    y = np.array([0.5, 1.5, 0.5, 1.0, 0.5, 99, 0.5, 1.5], np.float32)
    (sampled,) = bilinear([plane], x, y)
    np.testing.assert_allclose(sampled, [0, 110, 5, 55, 0, 120, 0, 120], atol=1e-4)


def test_a_fitted_plane_has_the_values_of_its_points(rng: np.random.Generator) -> None:
    """Catches a fit that only blurs. Where points are sparser than texels, the samples must equal the colours of the
    points.
    """
    x, y = (rng.uniform(2, 38, 200).astype(np.float32) for _ in range(2))
    values = (20 * np.sin(x / 3) + y).astype(np.float32)
    plane = fit_plane(values, x, y, np.ones(200, np.float32), (40, 40))
    (sampled,) = bilinear([plane], x, y)
    assert np.sqrt(np.square(sampled - values).mean()) < 0.1 * values.std()


def test_positions_are_those_of_the_camera(rng: np.random.Generator) -> None:
    """Catches a projection without skew or principal point, and rounding errors that are too large."""
    camera = ring(5, size=500)[3]
    xyz = rng.normal(0, 0.4, (100, 3)).astype(np.float32)
    pixels, _ = camera.project(xyz)
    np.testing.assert_allclose(np.stack(project(xyz, camera, 0.5), axis=1), pixels / 2, atol=2e-3)


def test_large_pictures_get_images_of_the_density_of_the_points(rng: np.random.Generator) -> None:
    """Catches images that have the size of the cameras' pictures, although the points are larger than pixels."""
    frame = smooth_frame(300, 4, rng)
    scales = []
    for size in (48, 480, 4800):
        described = replace(manifest(4, 1), source_cameras=ring(4, size))
        scale = choose_scale(frame, described, LEVELS["video"][0])
        assert scale is not None
        scales.append(scale)
    assert 1 >= scales[0] > 5 * scales[2]
    assert scales[1] == pytest.approx(10 * scales[2])


def test_a_whole_scene_has_images_of_its_background(tmp_path: Path) -> None:
    """Catches a background without images, and shadows that are not applied to sampled colours."""
    write_full_scene(tmp_path / "scene.4dv", background_points=3000)
    report = pack_scene(tmp_path / "scene.4dv", tmp_path / "packed.4dv", "video")
    assert report.colour_psnr is not None
    reader = SceneReader(tmp_path / "packed.4dv")
    encoding = reader.manifest.encoding
    assert encoding is not None
    assert encoding.background is not None
    assert encoding.background.image_scale is not None
    background, frame = reader.read_background(), reader.read(1)
    assert background is not None
    assert not np.array_equal(frame.rgb[-3000:], background.rgb)


def test_packing_twice_gives_the_same_bytes(packed: Path) -> None:
    """Catches images that depend on the threads of the encoder, or that contain the time."""
    again = packed.with_name("again.4dv")
    pack_scene(packed.with_name("scene.4dv"), again, "video", level=0)
    assert again.read_bytes() == packed.read_bytes()


def with_image(path: Path, change: Change, member: str = MEMBER) -> Path:
    """Copy a scene with one changed image. The checksums of the copy are correct."""

    def rewrite(members: dict[str, bytes]) -> None:
        content = zstandard.ZstdDecompressor().decompress(members[member])
        points = SceneReader(path).manifest.points[0]
        members[member] = zstandard.ZstdCompressor().compress(content[:points] + change(content[points:]))

    return rewritten(path, rewrite)


def set_header(**fields: int) -> Change:
    """Return a function that changes fields of an image's header."""
    names = ("left", "top", "width", "height", "size")

    def change(image: bytes) -> bytes:
        values = dict(zip(names, HEADER.unpack_from(image), strict=True)) | fields
        return HEADER.pack(*values.values()) + image[HEADER.size :]

    return change


def with_frame(change: Change) -> Change:
    """Return a function that changes the VP9 frame of an image, and corrects the size in the header."""

    def changed(image: bytes) -> bytes:
        frame = change(image[HEADER.size :])
        return set_header(size=len(frame))(image[: HEADER.size]) + frame

    return changed


def encoded(codec: str, size: int = 48) -> bytes:
    """Return the first frame of a grey video in another codec."""
    context = av.CodecContext.create(codec, "w")
    context.width = context.height = size
    context.pix_fmt, context.time_base = "yuv420p", Fraction(1)
    frame = av.VideoFrame(size, size, "yuv420p")
    return b"".join(bytes(packet) for packet in [*context.encode(frame), *context.encode(None)])


def bigger(frame: bytes) -> bytes:
    """Return a VP9 frame that declares a width of 65,536 texels."""
    bits = int.from_bytes(frame[4:9], "big") | 0xFFFF << 20
    return frame[:4] + bits.to_bytes(5, "big") + frame[9:]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda image: image[:-9], r"expected an image of \d+ bytes in frames/000000, got \d+; the file is damaged"),
        (lambda image: image[:7], "expected an image header of 12 bytes in frames/000000, got 7"),
        (set_header(width=400), r"expected an image inside \d+ x \d+ texels in frames/000000, got 400 x"),
        (set_header(left=400), r"expected an image inside \d+ x \d+ texels in frames/000000, got"),
        (set_header(size=2**31), r"expected an image of 2147483648 bytes in frames/000000, got \d+"),
        (with_frame(lambda frame: frame[:16]), "expected an intact VP9 frame in frames/000000, got .*is damaged"),
        (with_frame(bigger), r"expected a VP9 frame of \d+ x \d+ in frames/000000, got 65536 x \d+"),
        (
            with_frame(lambda frame: bytes(len(frame))),
            "expected a key frame of VP9 in frames/000000, got other content",
        ),
        (with_frame(lambda _: encoded("libvpx")), "expected a key frame of VP9 in frames/000000, got other content"),
        (with_frame(lambda _: b""), "expected a key frame of VP9 in frames/000000, got other content"),
        (with_frame(lambda frame: b"\x86" + frame[1:]), "expected a key frame of VP9 in frames/000000, got other"),
        (
            with_frame(lambda frame: frame + b"\xc1" + bytes(2) + b"\xc1"),
            "expected one frame of VP9 in frames/000000, got several frames",
        ),
    ],
)
def test_damaged_images_are_named(packed: Path, change: Change, message: str) -> None:
    """Catches images that cause a traceback or wrong colours without a message, and memory that is allocated for a
    wrong declared size.
    """
    reader = SceneReader(with_image(packed, change))
    with pytest.raises(UserError, match=message) as caught:
        reader.read(0)
    assert "\n" not in str(caught.value)
    assert reader.read(1).point_count == SceneReader(packed).read(1).point_count


def test_an_image_of_another_size_than_its_header_is_refused() -> None:
    """Catches a decoder that allocates memory for the size in the VP9 frame, which can be thousands of times too
    large."""
    camera = ring(3)[0]
    points = np.zeros((20, 3), np.float32)
    image = make_image(points, np.ones((20, 3), np.float32), np.ones(20, np.float32), camera, 1.0, 30)
    assert decode_image(image, camera, 1.0).planes[0].dtype == np.uint8
    left, top, width, height, size = HEADER.unpack_from(image)
    lie = HEADER.pack(left, top, width + 2, height, size) + image[HEADER.size :]
    with pytest.raises(StreamError, match=f"a VP9 frame of {width + 2} x {height}, got {width} x {height}"):
        decode_image(lie, camera, 1.0)


@pytest.mark.parametrize("scale", [0, 2, -1, float("nan"), "1"])
def test_an_invalid_scale_is_named(packed: Path, scale: object) -> None:
    """Catches an image scale that allows images of any size."""
    path = with_manifest(packed, lambda content: content["encoding"]["dynamic"].update({"image_scale": scale}))
    with pytest.raises(UserError, match=r"dynamic, image_scale: expected a number (>= 0\.015625|<= 1\.0|or null), got"):
        SceneReader(path)


def test_the_file_has_a_version_that_older_programs_refuse(packed: Path) -> None:
    """Catches a file that older players read as colours of points."""
    assert SceneReader(packed).manifest.version == 4
    pack_scene(packed, packed.with_name("stream.4dv"), "stream")
    assert SceneReader(packed.with_name("stream.4dv")).manifest.version == 3
    (size,) = struct.unpack_from("<L", packed.read_bytes(), 22)
    assert size > 0


def test_a_missing_decoder_is_named(
    packed: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a traceback, and black pictures, on machines without PyAV."""
    for name in [name for name in sys.modules if name.startswith(("av.", "fourd.cli.scenes", "fourd.viewer.output"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(UserError, match="expected the package av, got none; install it: pip install av"):
        SceneReader(packed).read(0)
    out = packed.with_name("pictures")
    assert main(["render", str(packed), "--views", "00", "-o", str(out)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert any("pip install av" in line for line in lines)
    assert main(["pack", str(packed.with_name("scene.4dv")), "-o", f"{out}.4dv", "--tier", "video"]) == 2
    assert "pip install av" in capsys.readouterr().err


def test_the_command_prints_the_quality_of_the_colours(packed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches lossy colours without a message that says so, and a scene that cannot be drawn."""
    scene, out, pictures = packed.with_name("scene.4dv"), packed.with_name("again.4dv"), packed.with_name("pictures")
    assert main(["pack", str(scene), "-o", str(out), "--tier", "video"]) == 0
    printed = capsys.readouterr().err
    assert "PSNR of the colours in the source views" in printed
    assert "images and blend weights of all source views" in printed
    assert main(["info", str(out)]) == 0
    assert "version 4, packed, tier video" in capsys.readouterr().out
    assert main(["render", str(out), "--views", "00", "-o", str(pictures)]) == 0
    assert list(pictures.rglob("*.png"))
