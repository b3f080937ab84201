"""Scenes with sound: the file format, and the commands that copy scenes."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.recording.soundtrack.opus import decode_opus, encode_opus
from fourd.scene import SceneReader, SceneWriter
from fourd.scene.files.sound import SOUND_NAME, OpusSound, SceneSound
from fourd.scene.manifest import manifest_from_json
from fourd.viewer.publish.site import write_site
from tests.baking.scenes import manifest, random_frame, write_scene
from tests.sound.claps import clap, onsets, write_clap_scene
from tests.sound.test_ogg import bomb
from tests.viewer.test_headless import rewrite_manifest


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of 2 s with a clap at 0.667 s. Tests must not change it."""
    return write_clap_scene(tmp_path_factory.mktemp("clap") / "clap.4dv", points=50)


def claps(path: Path) -> list[float]:
    """The times of the claps of a scene."""
    reader = SceneReader(path)
    sound = reader.read_sound()
    reader.close()
    assert sound is not None
    return [sound.start + time for time in onsets(np.concatenate(list(decode_opus(sound.content)), axis=1))]


def test_sound_is_read_back(scene: Path) -> None:
    """Catches a scene without its sound, and a description that does not fit it."""
    reader = SceneReader(scene)
    sound = reader.read_sound()
    assert sound is not None
    assert reader.manifest.version == 5
    assert reader.manifest.sound == SceneSound(0.0, 2.0, 1, len(sound.content))
    assert claps(scene) == pytest.approx([20 / 30], abs=1e-3)


def test_scenes_without_sound_stay_as_they_are(tmp_path: Path) -> None:
    """Catches a new format version of scenes that older programs can read."""
    write_scene(tmp_path / "scene.4dv")
    reader = SceneReader(tmp_path / "scene.4dv")
    assert reader.manifest.version == 1
    assert reader.read_sound() is None
    with zipfile.ZipFile(tmp_path / "scene.4dv") as archive:
        assert b"sound" not in archive.read("manifest.json")
        assert SOUND_NAME not in archive.namelist()


@pytest.mark.parametrize("tier", ["full", "stream", "video", "light"])
def test_packed_scenes_keep_the_sound(scene: Path, tmp_path: Path, tier: str) -> None:
    """Catches a tier that loses the sound, or whose manifest is not read as packed."""
    assert main(["pack", str(scene), "-o", str(tmp_path / "packed.4dv"), "--tier", tier]) == 0
    reader = SceneReader(tmp_path / "packed.4dv")
    original, copied = SceneReader(scene).read_sound(), reader.read_sound()
    assert reader.manifest.encoding is not None
    assert reader.manifest.version == 5
    assert original is not None
    assert copied is not None
    assert copied.content == original.content
    reader.read(20)


def test_pages_keep_the_sound(scene: Path, tmp_path: Path) -> None:
    """Catches a page without sound, whether its scene is packed for it or was packed before."""
    write_site(scene, tmp_path / "site", "stream")
    write_site(tmp_path / "site" / "scene.4dv", tmp_path / "again", "stream")
    assert claps(tmp_path / "again" / "scene.4dv") == pytest.approx([20 / 30], abs=1e-3)


@pytest.mark.parametrize(
    ("words", "expected", "line"),
    [
        (["--trim", "10:40"], [10 / 30], ""),
        (["--trim", "10:40", "--brightness", "0.5"], [10 / 30], ""),
        (["--brightness", "0.5"], [20 / 30], ""),
        (["--trim", "0:60:2"], None, "the sound is left out, because the edited scene plays at another speed"),
        (["--speed", "0.5"], None, "the sound is left out, because the edited scene plays at another speed"),
    ],
)
@pytest.mark.parametrize("packed", [False, True])
def test_edits_cut_the_sound(
    scene: Path,
    tmp_path: Path,
    words: list[str],
    expected: list[float] | None,
    line: str,
    packed: bool,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Catches sound that does not move with the kept frames, or that plays under a scene of another speed."""
    given = tmp_path / "given.4dv"
    if packed:
        assert main(["pack", str(scene), "-o", str(given)]) == 0
    out = tmp_path / "out.4dv"
    assert main(["edit", str(given if packed else scene), "-o", str(out), *words]) == 0
    err = capsys.readouterr().err
    assert (line in err) if line else "the sound is" not in err
    reader = SceneReader(out)
    assert (reader.manifest.sound is None) == (expected is None)
    assert reader.manifest.version == (5 if expected else 3 if packed else 1)
    if expected is not None:
        assert claps(out) == pytest.approx(expected, abs=2e-3)
        assert reader.manifest.sound is not None
        assert reader.manifest.sound.duration == pytest.approx(reader.manifest.seconds, abs=1e-3)


def test_sound_that_starts_late_is_cut_too(tmp_path: Path) -> None:
    """Catches a start of the sound that is ignored."""
    write_clap_scene(tmp_path / "late.4dv", points=50, start=0.5)
    assert claps(tmp_path / "late.4dv") == pytest.approx([20 / 30], abs=1e-3)
    for trim, at in (("3:60", 17 / 30), ("18:60", 2 / 30)):
        assert main(["edit", str(tmp_path / "late.4dv"), "-o", str(tmp_path / "out.4dv"), "--trim", trim]) == 0
        assert claps(tmp_path / "out.4dv") == pytest.approx([at], abs=2e-3)


def test_info_and_verify_name_the_sound(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a description without the sound, and a verification that does not look at it."""
    assert main(["info", str(scene)]) == 0
    assert "2.00 s, Opus, mono" in capsys.readouterr().out
    assert main(["verify", str(scene)]) == 0
    assert "whole; 60 frames and sound" in capsys.readouterr().out


def replace_sound(scene: Path, out: Path, content: bytes, **described: object) -> Path:
    """Replace the member with the sound, and keys of its description."""
    unpacked = rewrite_manifest(
        scene, out.with_suffix(".tmp"), lambda keys: keys["sound"].update({"bytes": len(content), **described})
    )
    with zipfile.ZipFile(unpacked) as archive, zipfile.ZipFile(out, "w") as written:
        for name in archive.namelist():
            written.writestr(name, content if name == SOUND_NAME else archive.read(name))
    return out


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda sound: {"content": sound[:300]}, "expected a complete Ogg file in sound.ogg, got a part of one"),
        (lambda sound: {"content": sound, "bytes": 12}, "expected 12 bytes in sound.ogg according to the manifest"),
        (lambda sound: {"content": b"RIFF" * 50}, "expected an Ogg file with one stream in sound.ogg"),
        (lambda sound: {"content": bomb(3600)}, "expected 2 s of sound in sound.ogg, got 3599.99"),
        (lambda sound: {"content": bomb(3600), "duration": 3600.0}, "expected sound that ends with the scene, at 2 s"),
        (lambda sound: {"content": sound, "channels": 2}, "expected 2 channels of sound in sound.ogg, got 1"),
        (lambda sound: {"content": sound, "codec": "vorbis"}, "sound, codec"),
        (lambda sound: {"content": sound, "start": -1.0}, "sound, start"),
        (lambda sound: {"content": sound, "duration": 1e-9}, "expected 1e-09 s of sound in sound.ogg, got 2"),
        (lambda sound: {"content": b"x" * 300_000}, "expected at most 193536 bytes for 2 s of sound, got 300000"),
    ],
)
@pytest.mark.parametrize("command", ["verify", "pack", "view"])
def test_broken_sound_is_one_line(
    scene: Path, tmp_path: Path, change: object, words: str, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a damaged or malicious sound that reaches the decoder, and errors of several lines."""
    sound = SceneReader(scene).read_sound()
    assert sound is not None
    assert callable(change)
    path = replace_sound(scene, tmp_path / "broken.4dv", **change(sound.content))
    more = {"verify": [], "pack": ["-o", str(tmp_path / "out.4dv")], "view": ["--headless", str(tmp_path / "a.mp4")]}
    assert main([command, str(path), *more[command]]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "broken.4dv" in line]
    assert len(lines) == 1
    assert words in lines[0]


def test_missing_sound_is_refused(scene: Path, tmp_path: Path) -> None:
    """Catches a manifest that describes a sound that the file lacks."""
    with zipfile.ZipFile(scene) as archive, zipfile.ZipFile(tmp_path / "a.4dv", "w") as written:
        for name in archive.namelist():
            if name != SOUND_NAME:
                written.writestr(name, archive.read(name))
    with pytest.raises(UserError, match=r"expected a member sound\.ogg, got none"):
        SceneReader(tmp_path / "a.4dv")


def test_the_writer_refuses_other_sound(tmp_path: Path) -> None:
    """Catches a scene that no reader would open."""
    long = encode_opus([clap(2, 1)], 1)
    for sound, words in (
        (OpusSound(b"x"), "complete Ogg"),
        (OpusSound(long), "ends with the scene"),
        (OpusSound(long, -1.0), "ends with the scene"),
    ):
        with (
            pytest.raises(ValueError, match=words),
            SceneWriter(tmp_path / "a.4dv", manifest(6, 3)) as writer,
        ):
            writer.add_frame(0, random_frame(5, 6, 0))
            writer.add_sound(sound)
    assert not (tmp_path / "a.4dv").exists()


def test_keys_of_older_versions_are_ignored(tmp_path: Path) -> None:
    """Catches a key `sound` that another program has added to an older version."""
    write_scene(tmp_path / "scene.4dv")
    with zipfile.ZipFile(tmp_path / "scene.4dv") as archive:
        text = archive.read("manifest.json").replace(b'"kind"', b'"sound": 5, "kind"')
    assert manifest_from_json(text).sound is None
