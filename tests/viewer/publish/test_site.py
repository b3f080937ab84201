"""Sites: their files, and the scene in the form that browsers read."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.cli.scenes.web import check_url
from fourd.scene import SceneReader
from fourd.scene.files.encoding import Tier
from fourd.scene.packed.streams import StreamError, compress, decompress
from fourd.scene.packing.pack import pack_scene
from fourd.scene.packing.transcode import transcode_scene
from fourd.scene.packing.writer import Storage
from fourd.scene.styles import decode_octahedral
from fourd.viewer.publish.server import SiteServer
from fourd.viewer.publish.site import SCENE_NAME, is_site, write_site
from tests.baking.scenes import write_full_scene, write_scene
from tests.viewer.scenes import write_shells


def test_files_of_a_site(tmp_path: Path) -> None:
    """Catches a site without the modules that its page loads, a site with the examples, and text of the title that
    becomes markup. Also catches a preview image with a relative address, which no program finds."""
    write_scene(tmp_path / "scene.4dv")
    write_site(tmp_path / "scene.4dv", tmp_path / "site", "stream", title="<b>")
    assert "og:image" not in (tmp_path / "site" / "index.html").read_text()
    write_site(tmp_path / "scene.4dv", tmp_path / "site", "stream", title="<b>", url="https://example.com/a")
    names = {path.relative_to(tmp_path / "site").as_posix() for path in (tmp_path / "site").rglob("*.*")}
    assert {"index.html", "page.css", "poster.jpg", SCENE_NAME, "player/fourd-player.js"} <= names
    assert {"player/decode/worker.js", "player/sort/worker.js", "player/stylize.json"} <= names
    assert not any("examples" in name for name in names)
    page = (tmp_path / "site" / "index.html").read_text()
    assert "<title>&lt;b&gt;</title>" in page
    assert 'name="description" content="&lt;b&gt;: ' in page
    assert '"og:image" content="https://example.com/a/poster.jpg"' in page
    assert "{{" not in page
    preloaded = re.findall(r'"modulepreload" href="([^"]+)"', page)
    assert len(preloaded) > 20
    assert set(preloaded) <= names


@pytest.mark.parametrize("url", ["example.com", "ftp://example.com/", "https://", "https://example.com/?a=1"])
def test_an_address_that_is_no_page_is_refused(url: str) -> None:
    """Catches a preview image at an address that nobody can open."""
    with pytest.raises(UserError, match=r"--url: expected an address such as https://example\.com/scene/, got"):
        check_url(url)


def test_transcoding_keeps_the_points(tmp_path: Path) -> None:
    """Catches points that are quantised a second time, and members that are still compressed with Zstandard."""
    write_full_scene(tmp_path / "scene.4dv")
    pack_scene(tmp_path / "scene.4dv", tmp_path / "packed.4dv", "full")
    transcode_scene(tmp_path / "packed.4dv", tmp_path / "web.4dv", Storage("zlib", (2, 0, 1)))
    packed, web = SceneReader(tmp_path / "packed.4dv"), SceneReader(tmp_path / "web.4dv")
    for index in range(packed.manifest.frame_count):
        for name, array in packed.read(index).arrays.items():
            np.testing.assert_array_equal(web.read(index).arrays[name], array)
    assert web.read_member("frames/000000/points")[0] == 0x78
    with zipfile.ZipFile(tmp_path / "web.4dv") as archive:
        views = [name[-3:] for name in archive.namelist() if name.startswith("frames/000000/views/")]
    assert views == ["003", "004", "005", "002", "000", "001"]
    packed.close()
    web.close()


@pytest.mark.parametrize("tier", ["stream", "video", "light"])
def test_sites_have_normals(tier: Tier, tmp_path: Path) -> None:
    """Catches normals whose order differs from the order of the points, and a site without the scene's normals. Also
    catches a file in which the members that every player fetches are not adjacent.
    """
    write_shells(tmp_path / "scene.4dv", frames=1, points=3000)
    write_site(tmp_path / "scene.4dv", tmp_path / "site", tier)
    pack_scene(tmp_path / "scene.4dv", tmp_path / "packed.4dv", tier)
    transcode_scene(tmp_path / "packed.4dv", tmp_path / "web.4dv", Storage("zlib"), has_normals=True)
    transcode_scene(tmp_path / "web.4dv", tmp_path / "again.4dv", Storage("zlib"))
    for path in (tmp_path / "site" / SCENE_NAME, tmp_path / "web.4dv", tmp_path / "again.4dv"):
        reader = SceneReader(path)
        frame = reader.read(0)
        reader.close()
        assert frame.normals is not None
        outwards = frame.xyz / np.linalg.norm(frame.xyz, axis=1, keepdims=True)
        # Normals of points that no camera sees from the front are flipped towards the cameras, so their error is
        # larger.
        assert np.median(np.abs((decode_octahedral(frame.normals) * outwards).sum(1))) > 0.85
        with zipfile.ZipFile(path) as archive:
            assert archive.namelist()[-1] == "frames/000000/optional/normals"
    packed = SceneReader(tmp_path / "packed.4dv")
    assert packed.read(0).normals is None
    packed.close()


def test_errors_of_zlib_members() -> None:
    """Catches a damaged zlib member that is read without an error."""
    member = compress(bytes(1000), "zlib")
    assert len(decompress(member, 1000)) == 1000
    for damaged, expected in (
        (member[:-6], "expected the complete zlib stream"),
        (b"other", "expected Zstandard or zlib data"),
        (member[:-1] + b"\2", "expected Zstandard or zlib data"),
        (compress(bytes(10**6), "zlib"), "expected at most 1000 bytes, got more"),
    ):
        with pytest.raises(StreamError, match=expected):
            decompress(damaged, 1000)


def test_other_folders_are_kept(tmp_path: Path) -> None:
    """Catches a site that overwrites a folder that contains other files."""
    write_scene(tmp_path / "scene.4dv")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").write_text("x")
    with pytest.raises(UserError, match="expected a new folder or an earlier site, got a folder with other files"):
        write_site(tmp_path / "scene.4dv", tmp_path / "mine", "stream")
    assert (tmp_path / "mine" / "file").exists()


def test_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches commands that end with a traceback for wrong input."""
    write_scene(tmp_path / "scene.4dv")
    assert main(["web", str(tmp_path / "scene.4dv"), "-o", str(tmp_path / "site"), "--tier", "light"]) == 0
    assert "next: fourd serve" in capsys.readouterr().err.replace("\n", " ")
    for words, expected in (
        (["web", str(tmp_path / "none.4dv"), "-o", str(tmp_path / "other")], "expected a .4dv file"),
        (["serve", str(tmp_path)], "expected a .4dv file, a run or a folder of fourd web, got another folder"),
        (["serve", str(tmp_path / "none.4dv"), "--port", "0"], "expected a .4dv file"),
        (["serve", str(tmp_path / "site"), "--port", "70000"], "--port: expected 0 to 65535, got 70000"),
    ):
        assert main(words) == 2
        error = capsys.readouterr().err
        assert expected in error
        assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "other").exists()


def test_styles_of_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a style that is missing in the page, and wrong style files that cause a traceback or leave an outdated
    page.
    """
    write_scene(tmp_path / "scene.4dv", frames=1)
    for name, text in (("blue", "shading: gooch"), ("toon", ""), ("wrong", "shadin: toon")):
        (tmp_path / f"{name}.yaml").write_text(text)
    words = ["web", str(tmp_path / "scene.4dv"), "-o", str(tmp_path / "site")]
    for name, expected in (
        ("toon.yaml", "expected a style with a new name, got"),
        ("wrong.yaml", "shading"),
        ("none.yaml", "expected a style with a new name"),
        ("other.yaml", "other.yaml"),
        ("gooch", "expected a .yaml file, got"),
    ):
        assert main([*words, "--style", str(tmp_path / name)]) == 2
        error = capsys.readouterr().err
        assert expected in error
        assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "site").exists()
    assert main([*words, "--style", str(tmp_path / "blue.yaml"), "--no-normals"]) == 0
    styles = json.loads((tmp_path / "site" / "player" / "stylize.json").read_text())["styles"]
    assert [style["name"] for style in styles] == ["toon", "xtoon", "gooch", "ink", "blue"]
    assert main(["serve", str(tmp_path / "site"), "--style", str(tmp_path / "blue.yaml")]) == 2
    assert "--style: expected a scene or a run, got the site" in capsys.readouterr().err


def test_a_connection_chooses_the_level(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an option that is ignored, and a rate that does not include the compression of web pages."""
    write_scene(tmp_path / "scene.4dv", frames=2, points=3000)
    sizes = []
    for mbps in (100, 8):
        words = ["web", str(tmp_path / "scene.4dv"), "-o", str(tmp_path / "site"), "--max-mbps", str(mbps)]
        assert main(words) == 0
        assert f"--max-mbps {mbps}: tier " in capsys.readouterr().err
        sizes.append((tmp_path / "site" / "scene.4dv").stat().st_size)
    assert sizes[1] < 0.8 * sizes[0]
    pack_scene(tmp_path / "scene.4dv", tmp_path / "packed.4dv", "full")
    assert main(["web", str(tmp_path / "packed.4dv"), "-o", str(tmp_path / "site"), "--max-mbps", "8"]) == 2
    assert "--max-mbps: expected a scene that is not packed, got" in capsys.readouterr().err


def test_serving_a_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a command that serves a folder other than the site, and temporary files that are not removed."""
    write_scene(tmp_path / "scene.4dv")
    opened, folders = [], []
    monkeypatch.setattr("webbrowser.open", opened.append)

    def interrupted(server: SiteServer) -> None:
        folders.append(server.folder)
        assert is_site(server.folder)
        assert "links live>" in (server.folder / "index.html").read_text()
        raise KeyboardInterrupt

    monkeypatch.setattr(SiteServer, "serve_forever", interrupted)
    assert main(["serve", str(tmp_path / "scene.4dv"), "--port", "0", "--tier", "light"]) == 0
    assert opened[0].startswith("http://127.0.0.1:")
    assert opened[0] in capsys.readouterr().err
    assert not folders[0].exists()
    assert main(["serve", str(tmp_path / "scene.4dv"), "--port", "0", "--tier", "light", "--no-browser"]) == 0
    assert len(opened) == 1
