"""Viewer sessions: opening and closing of scenes, waiting for frames, and runs whose training continues."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.scene import SceneReader
from fourd.viewer.comparison.placement import find_view_of_pose
from fourd.viewer.display import CropBox, DisplaySettings
from fourd.viewer.navigation.saved_views import SavedViews
from fourd.viewer.playback.sources import RunSource, open_frame_source
from fourd.viewer.rendering.offscreen import OffscreenRenderer
from fourd.viewer.session import TRANSITION_SECONDS, LoadedScene, Session
from tests.baking.scenes import manifest, random_frame, write_scene
from tests.training.small import SMALL, train, trained_run, with_steps

SIZE = (64, 48)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    write_scene(tmp_path / "one.4dv", frames=4)
    return tmp_path / "one.4dv"


def open_scene(session: Session, path: Path) -> LoadedScene:
    session.open(path)
    found = session.take_opened(wait=True)
    assert found is not None, session.message
    session.show(found, found.initial_pose(SIZE))
    return found


def test_a_scene_that_cannot_be_opened_leaves_the_open_one(scene: Path, tmp_path: Path) -> None:
    """Catches a viewer that loses its open scene after a failed opening, and a message that does not name the file."""
    session = Session(DisplaySettings())
    open_scene(session, scene)
    before = session.render_request(SIZE, wait=True)
    (tmp_path / "broken.4dv").write_bytes(b"no scene")
    session.open(tmp_path / "broken.4dv")
    assert session.take_opened(wait=True) is None
    assert "broken.4dv: expected a complete .4dv scene" in session.message
    after = session.render_request(SIZE, wait=True)
    assert before is not None
    assert after is not None
    assert (after.frame, after.camera) == (before.frame, before.camera)
    session.close()


def test_a_damaged_frame_keeps_the_previous_one_and_sets_a_message(scene: Path) -> None:
    """Catches an empty image or a crash if one frame of a scene cannot be read."""
    content = bytearray(scene.read_bytes())
    frame = SceneReader(scene).read(2)
    offset = content.find(frame.xyz.tobytes())
    content[offset : offset + 4] = np.float32(np.nan).tobytes()
    scene.write_bytes(bytes(content))
    session = Session(DisplaySettings())
    open_scene(session, scene)
    session.playback.seek(1)
    good = session.render_request(SIZE, wait=True)
    session.playback.seek(2)
    with pytest.raises(UserError, match=r"one\.4dv"):
        session.render_request(SIZE, wait=True)
    damaged = session.render_request(SIZE)
    assert good is not None
    assert damaged is not None
    assert damaged.frame is good.frame
    assert "one.4dv" in session.message
    assert not session.is_waiting
    session.playback.seek(3)
    assert session.render_request(SIZE, wait=True) is not None
    session.close()


class SlowSource:
    """A frame source that waits for an event before it reads."""

    def __init__(self) -> None:
        self.manifest = manifest(2, 3)
        self.is_ready = threading.Event()

    def read(self, index: int):
        self.is_ready.wait()
        return random_frame(10 + index, 2, seed=index)

    def read_sound(self) -> None:
        return None

    def close(self) -> None:
        pass


def test_a_slow_source_does_not_block_the_viewer(tmp_path: Path) -> None:
    """Catches a window that freezes until a frame is read, and playback that continues while the current frame is not
    loaded.
    """
    source = SlowSource()
    session = Session(DisplaySettings())
    session.show(LoadedScene(tmp_path / "slow.4dv", source), LoadedScene(tmp_path, SlowSource()).initial_pose(SIZE))
    assert session.render_request(SIZE) is None
    assert session.is_waiting
    session.advance(0.05)
    assert session.playback.frame == 0, "playback advances while no frame is there"
    source.is_ready.set()
    assert session.render_request(SIZE, wait=True) is not None
    assert not session.is_waiting
    session.close()


def test_unchanged_requests_reuse_their_objects(scene: Path) -> None:
    """Catches a session that creates new cameras and scaled frames for every image. Renderers would sort and upload the
    points again."""
    session = Session(replace(DisplaySettings(), point_scale=1.5))
    open_scene(session, scene)
    one, other = session.render_request(SIZE, wait=True), session.render_request(SIZE, wait=True)
    assert one is not None
    assert other is not None
    assert one.frame is other.frame
    assert one.camera is other.camera
    assert session.pose is not None
    session.set_pose(session.pose.dolly(0.9))
    moved = session.render_request(SIZE, wait=True)
    assert moved is not None
    assert moved.camera is not one.camera
    assert moved.frame is one.frame
    session.close()


def test_points_outside_the_crop_box_are_hidden(scene: Path) -> None:
    """Catches a box that hides other points, an empty box that stops the viewer, and one that the next scene keeps."""
    session = Session(DisplaySettings())
    open_scene(session, scene)
    whole = session.render_request(SIZE, wait=True)
    assert whole is not None
    session.settings = replace(session.settings, crop=CropBox((-9.0, -9.0, 0.1), (9.0, 9.0, 9.0)))
    cropped = session.render_request(SIZE, wait=True)
    assert cropped is not None
    inside = whole.frame.xyz[:, 2] >= np.float32(0.1)
    assert np.array_equal(cropped.frame.xyz, whole.frame.xyz[inside])
    assert np.array_equal(cropped.frame.rgb, whole.frame.rgb[inside])
    session.settings = replace(session.settings, crop=CropBox((8.0, 8.0, 8.0), (9.0, 9.0, 9.0)))
    nothing = session.render_request(SIZE, wait=True)
    assert nothing is not None
    with OffscreenRenderer("cpu") as offscreen:
        assert offscreen.render(whole).any()
        assert not offscreen.render(nothing).any()
    open_scene(session, scene)
    assert session.settings.crop is None
    session.close()


def test_the_user_s_layers_override_the_scene_s(tmp_path: Path) -> None:
    """Catches a scene that is drawn with the number of layers of the previous scene. Also catches a number of layers
    that the user chose and that the next scene resets.
    """
    write_scene(tmp_path / "one.4dv")
    session = Session(DisplaySettings(layers=0))
    open_scene(session, tmp_path / "one.4dv")
    assert session.settings.layers == 12
    session.set_layers(5)
    open_scene(session, tmp_path / "one.4dv")
    assert session.settings.layers == 5
    session.close()


def test_transitions_end_exactly_and_input_ends_them(scene: Path) -> None:
    """Catches a transition that continues after the user has moved the camera."""
    session = Session(DisplaySettings())
    found = open_scene(session, scene)
    end = found.camera_pose(3, SIZE)
    session.move_to(end)
    session.advance(TRANSITION_SECONDS / 2)
    assert session.pose is not end
    assert session.is_moving
    session.advance(TRANSITION_SECONDS)
    assert session.pose is end
    assert not session.is_moving
    session.move_to(found.initial_pose(SIZE))
    session.set_pose(end.dolly(2))
    session.advance(1)
    assert session.pose is not None
    assert session.pose.distance == 2 * end.distance
    session.close()


def test_a_run_shows_its_newest_checkpoint(ball_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a session that does not load new checkpoints of an open run."""
    monkeypatch.setattr("fourd.viewer.loaded_scene._CHECKPOINT_POLL_SECONDS", 0.0)
    run = trained_run(ball_capture, tmp_path / "run")
    session = Session(DisplaySettings())
    found = open_scene(session, run.folder)
    assert found.checkpoint == "00000006.safetensors"
    assert not session.advance(0)
    before = session.render_request(SIZE, wait=True)
    assert before is not None
    with OffscreenRenderer("cpu") as offscreen:
        assert offscreen.render(before).max() > 30
    train(run, with_steps(SMALL, 12))
    assert session.advance(0)
    assert session.render_request(SIZE) is not None, "the previous frame stays until the new one is read"
    after = session.render_request(SIZE, wait=True)
    assert after is not None
    assert not np.array_equal(after.frame.sh, before.frame.sh)
    session.close()


def test_a_run_s_frames_equal_those_of_its_export(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a live view of a run whose cameras, colours or shading differ from the exported scene. Also catches
    a bar that does not show how many views of a frame are done."""
    from fourd.reconstruction.training.run import load_run
    from fourd.scene.bake import bake_run
    from tests.training.small import quiet

    run = trained_run(ball_capture, tmp_path / "run")
    bake_run(load_run(run.folder), tmp_path / "scene.4dv", quiet())
    reported: list[str] = []
    live = RunSource(run.folder, reported.append)
    exported = open_frame_source(tmp_path / "scene.4dv")
    assert reported == ["loading torch", "reading the checkpoint"]
    track = live._tracker(4)  # two views of the frame, and the same two of the background
    shares = [live.share for _ in (*track(range(2), 2, "views"), *track(range(2), 2, "views"))]
    assert shares == [1.0] * 4
    assert [live.share for _ in live._tracker(4)(range(4), 4, "views")] == [0, 0.25, 0.5, 0.75]
    assert live.manifest.names == exported.manifest.names
    assert live.manifest.layers == exported.manifest.layers
    one, other = live.read(1), exported.read(1)
    assert live.share == 1
    for name in ("xyz", "radius", "density", "sh", "blend_weights", "rgb"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    exported.close()


def test_invalid_values_of_a_failed_training_raise(
    ball_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches NaN from a run that reaches the kernels. The frames of a run are not checked by a file reader."""
    run = trained_run(ball_capture, tmp_path / "run")
    source = RunSource(run.folder)

    def bake_invalid(*_: object):
        frame = random_frame(10, 2, seed=1)
        frame.radius[3] = np.nan
        return frame

    monkeypatch.setattr("fourd.scene.bake.bake_frame", bake_invalid)
    with pytest.raises(UserError, match="expected valid values of radius in frame 0 at step 6, got NaN, infinity or"):
        source.read(0)


def test_a_run_without_torch_sets_a_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a bare "No module named" in the window when a run's folder is dropped on it."""

    def raise_missing(*_: object) -> RunSource:
        raise ModuleNotFoundError("No module named 'torch'", name="torch")

    monkeypatch.setattr("fourd.viewer.playback.sources.RunSource", raise_missing)
    session = Session(DisplaySettings())
    session.open(tmp_path)
    assert session.take_opened(wait=True) is None
    assert session.message.endswith("got no torch; pip install 'fourd[train]'")
    session.close()


@pytest.mark.slow
def test_memory_stays_flat_over_many_frames_and_openings(tmp_path: Path) -> None:
    """Catches frames, threads, files and OpenGL objects that are not released. The test draws 1,000 images and opens
    100 scenes.
    """
    import os

    from fourd.reconstruction.training.memory import resident_bytes

    write_scene(tmp_path / "long.4dv", frames=50, points=4000)
    session = Session(DisplaySettings())

    def play(count: int) -> None:
        with OffscreenRenderer("cpu") as offscreen:
            for number in range(count):
                session.playback.seek(number % 50)
                request = session.render_request(SIZE, wait=True)
                assert request is not None
                offscreen.render(request)

    open_scene(session, tmp_path / "long.4dv")
    play(200)
    before = resident_bytes()
    play(1000)
    assert resident_bytes() - before < 32 << 20
    files, threads = len(os.listdir("/proc/self/fd")), threading.active_count()
    for _ in range(100):
        open_scene(session, tmp_path / "long.4dv")
        play(1)
    assert resident_bytes() - before < 48 << 20
    assert len(os.listdir("/proc/self/fd")) == files
    assert threading.active_count() == threads
    session.close()


def test_the_view_is_free_after_the_user_has_moved_it(scene: Path) -> None:
    """Catches a list of cameras that names a camera after the user has left its view."""
    session = Session(DisplaySettings())
    found = open_scene(session, scene)
    assert not session.is_free
    assert session.pose is not None
    session.set_pose(session.pose.orbit(0.1, 0.0))
    assert session.is_free
    session.move_to(found.camera_pose(0, SIZE))
    session.advance(TRANSITION_SECONDS / 2)
    assert not session.is_free
    session.close()


def test_a_kept_view_is_known_as_that_of_its_camera(scene: Path, tmp_path: Path) -> None:
    """Catches a list of cameras that shows "free" after a scene is opened again, although a camera's view is shown."""
    session = Session(DisplaySettings())
    found = open_scene(session, scene)
    for index in range(len(found.manifest.cameras)):
        SavedViews(tmp_path / "views.json").save(scene, found.camera_pose(index, SIZE))
        kept = SavedViews(tmp_path / "views.json").load(scene)
        assert kept is not None
        assert find_view_of_pose(found, kept, SIZE) == index
    assert find_view_of_pose(found, found.camera_pose(0, SIZE).orbit(0.1, 0.0), SIZE) is None
    session.close()


def test_a_shift_moves_the_picture_by_whole_pixels(scene: Path) -> None:
    """Catches a picture that is scaled or turned, instead of moved, when the panel opens."""
    session = Session(DisplaySettings())
    open_scene(session, scene)
    plain, moved = (session.render_request(SIZE, wait=True, shift=shift) for shift in ((0.0, 0.0), (7.0, -3.0)))
    assert plain is not None
    assert moved is not None
    with OffscreenRenderer("cpu") as renderer:
        before, after = renderer.render(plain), renderer.render(moved)
    assert before.any()
    # The filter of pixels changes the edges of an image.
    inside = np.s_[2:-2, 2:-2]
    difference = after[:-3, 7:][inside].astype(int) - before[3:, :-7][inside]
    assert np.abs(difference).max() <= 1
    session.close()
