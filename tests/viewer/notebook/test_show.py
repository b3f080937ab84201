"""fourd.show without a page: its files, its formats and its errors."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import fourd
from fourd.base.errors import UserError
from fourd.base.progress import Terminal
from fourd.scene.container import SceneReader
from fourd.viewer.notebook.served import MAX_RANGE, is_for_browsers, serve
from fourd.viewer.publish.site import write_scene as write_for_browsers
from tests.baking.scenes import write_scene

WITHOUT_ANYWIDGET = "import sys; sys.modules['anywidget'] = None\n"


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene that is not packed."""
    path = tmp_path_factory.mktemp("scene") / "ball.4dv"
    write_scene(path, frames=2, points=50)
    return path


@pytest.fixture(scope="module")
def packed(scene: Path) -> Path:
    """A scene as fourd web writes it."""
    path = scene.with_name("packed.4dv")
    write_for_browsers(scene, path, "stream", has_normals=False)
    return path


def test_an_unpacked_scene_is_packed_and_removed(scene: Path) -> None:
    """Catches a page that gets a file that it cannot read, and temporary files that remain."""
    pytest.importorskip("anywidget")
    widget = fourd.show(scene, quiet=True)
    path = widget._served.path
    assert path != scene
    assert is_for_browsers(path)
    widget.close()
    assert not path.parent.exists()
    assert scene.exists()


def test_a_scene_for_browsers_is_used_in_place(packed: Path) -> None:
    """Catches a copy of a large scene for each widget, and a widget that removes the user's file."""
    pytest.importorskip("anywidget")
    with fourd.open_scene(packed) as opened:
        widget = fourd.show(opened, quiet=True)
    assert widget._served.path == packed
    assert widget.scene is None
    widget.close()
    assert packed.exists()


def test_ranges_are_those_of_the_file(packed: Path) -> None:
    """Catches offsets that are off by one, and a page that makes the kernel read without limit."""
    served = serve(packed, "stream", Terminal(quiet=True))
    content = packed.read_bytes()
    assert served.read(5, 20) == content[5:25]
    assert served.read(len(content) - 3, 10) == content[-3:]
    for offset, size in ((-1, 5), (0, MAX_RANGE + 1), (0, -1), ("0", 5), (None, None)):
        with pytest.raises(UserError, match=f"expected a range of at most {MAX_RANGE} bytes"):
            served.read(offset, size)


def test_a_missing_file_is_named(scene: Path, tmp_path: Path) -> None:
    """Catches a widget that fails with a traceback after its file was removed."""
    path = tmp_path / "moved.4dv"
    write_for_browsers(scene, path, "stream", has_normals=False)
    served = serve(path, "stream", Terminal(quiet=True))
    path.unlink()
    with pytest.raises(UserError, match=r"moved\.4dv: expected the file of the scene, got none"):
        served.read(0, 5)


def test_a_damaged_scene_leaves_no_files(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a traceback for a damaged file, and a temporary folder that remains after an error."""
    import tempfile

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    damaged = tmp_path / "damaged.4dv"
    damaged.write_bytes(scene.read_bytes()[:-200])
    with pytest.raises(UserError, match=r"damaged\.4dv"):
        serve(damaged, "stream", Terminal(quiet=True))
    with pytest.raises(UserError, match="expected a run"):
        serve(tmp_path, "stream", Terminal(quiet=True))
    assert list((tmp_path / "temporary").iterdir()) == []


def test_the_bundle_has_a_picture_for_pages_without_scripts(scene: Path) -> None:
    """Catches a notebook that shows only text where scripts are off."""
    pytest.importorskip("anywidget")
    widget = fourd.show(scene, quiet=True)
    made = widget._repr_mimebundle_()
    assert made is not None
    data = made[0]
    widget.close()
    assert data["image/png"].startswith("iVBOR")
    assert data["text/html"] == f'<img src="data:image/png;base64,{data["image/png"]}" alt="First frame of ball.4dv">'
    assert data["application/vnd.jupyter.widget-view+json"]["model_id"]


def test_large_scenes_are_not_embedded(packed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a notebook file of gigabytes."""
    module = pytest.importorskip("fourd.viewer.notebook.widget", exc_type=ImportError)
    monkeypatch.setattr(module, "MAX_EMBEDDED", 1000)
    with pytest.raises(UserError, match="embed: expected a scene of at most 0 MB, got 0 MB; leave out embed"):
        fourd.show(packed, embed=True, quiet=True)


def test_a_missing_package_is_named(packed: Path) -> None:
    """Catches a ModuleNotFoundError that does not say which extra to install."""
    code = (
        f"{WITHOUT_ANYWIDGET}import fourd\ntry: fourd.show(sys.argv[1])\nexcept fourd.UserError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code, packed], capture_output=True, text=True, check=True)
    assert done.stdout == "fourd.show: expected the package anywidget, got none; pip install 'fourd[notebook]'\n"


def test_invalid_arguments_are_named(packed: Path) -> None:
    """Catches a height or colour that only fails in the page."""
    with pytest.raises(ValueError, match="height: expected 1 to 10000 pixels, got 0"):
        fourd.show(packed, height=0)
    with pytest.raises(ValueError, match="background: expected a colour such as #203040, got 'red'"):
        fourd.show(packed, background="red")
    with pytest.raises(UserError, match="expected a local path to show a scene, got a URL"):
        fourd.show("s3://bucket/scene.4dv")


def test_importing_fourd_imports_no_notebook() -> None:
    """Catches an import of ipywidgets, which takes a third of a second, by ``import fourd`` or by ``fourd --help``."""
    code = "import json, sys, fourd, fourd.cli.main\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    names = {name.partition(".")[0] for name in json.loads(done.stdout)}
    assert not names & {"IPython", "anywidget", "ipywidgets", "traitlets", "numpy"}


def test_a_scene_is_shown_as_a_picture(scene: Path) -> None:
    """Catches a scene that notebooks without the extension show as text, and pictures of the size of a camera's."""
    with fourd.open_scene(scene) as opened:
        picture = opened._repr_png_()
    assert picture is not None
    assert picture.startswith(b"\x89PNG")
    reader = SceneReader(scene)
    assert reader.manifest.cameras[0].width == int.from_bytes(picture[16:20], "big")
    reader.close()
