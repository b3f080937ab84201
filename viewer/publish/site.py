"""Writes the folder of a web page that plays a scene. The JavaScript code of the page is in viewer/web."""

from __future__ import annotations

import html
import shutil
from collections.abc import Mapping, Sequence
from importlib.resources import as_file, files
from pathlib import Path

from PIL import Image

from fourd.base.errors import UserError
from fourd.base.files import atomic_folder, is_unused
from fourd.base.progress import Track, untracked
from fourd.scene import SceneReader
from fourd.scene.files.encoding import Tier
from fourd.scene.packing.pack import pack_scene
from fourd.scene.packing.transcode import transcode_scene
from fourd.scene.packing.writer import Storage
from fourd.scene.player import Player
from fourd.scene.splats.reader import open_reader
from fourd.scene.styles import Style
from fourd.viewer.display import DEFAULT_BACKGROUND
from fourd.viewer.navigation.paths import order_by_azimuth
from fourd.viewer.publish.styles import STYLES_NAME, load_styles, write_styles

SCENE_NAME, PAGE_NAME, POSTER_NAME, PLAYER_FOLDER = "scene.4dv", "index.html", "poster.jpg", "player"
_POSTER_SIDE = 960
TRAINING_FOLDER = "training"
_NOT_SERVED = ("index.html", "page.css", "tsconfig.json", "examples", "notebook", "node_modules", "package-lock.json")


def write_site(
    source: Path,
    out: Path,
    tier: Tier,
    title: str | None = None,
    track: Track = untracked,
    *,
    level: int | None = None,
    styles: Mapping[str, Style] | None = None,
    has_normals: bool = True,
    url: str | None = None,
) -> None:
    """Write a folder with a page, a poster image, the player's modules and the scene.

    A packed scene keeps its tier, but its members are compressed again with zlib, because browsers cannot decompress
    Zstandard.

    Args:
        source: a `.4dv` file of any version, a `.4dgs` file, or splats or points (a file or a folder with a file for
            each frame).
        out: the folder to write. An earlier site in it is replaced.
        tier: tier (quality, such as "stream") in which the scene is packed, if it is not packed yet.
        title: title of the page, or None for the name of the source file.
        track: reports progress.
        level: index of the tier's level (a set of quantisation steps), as for
            :func:`fourd.scene.packing.pack.pack_scene`.
        styles: the styles that the page offers, by name. If None, the page offers the presets.
        has_normals: whether to write normals, which styles need. If the source has none, they are estimated.
        url: address at which the page will be, or None. Programs that show a preview of a link need it to find the
            poster image.

    Raises:
        UserError: if ``source`` is not a valid scene, or if ``out`` contains files but no earlier site.
    """
    if not is_unused(out) and not is_site(out):
        raise UserError(f"{out}: expected a new folder or an earlier site, got a folder with other files; change -o")
    with atomic_folder(out) as folder:
        write_scene(source, folder / SCENE_NAME, tier, track, level=level, has_normals=has_normals)
        write_poster(folder / SCENE_NAME, folder / POSTER_NAME)
        copy_player(folder, title or source.stem, styles=styles, url=url)


def is_site(folder: Path) -> bool:
    """Return True if a folder has the files that :func:`write_site` writes."""
    return all((folder / name).exists() for name in (PAGE_NAME, SCENE_NAME, PLAYER_FOLDER))


def write_scene(
    source: Path,
    out: Path,
    tier: Tier,
    track: Track = untracked,
    *,
    level: int | None = None,
    has_normals: bool = True,
) -> None:
    """Write a scene in the form that browsers read: packed and compressed with zlib. The arguments are those
    of :func:`write_site`. Raises UserError."""
    reader = open_reader(source)
    manifest = reader.manifest
    is_packed = manifest.encoding is not None
    reader.close()
    if manifest.frame_count == 0 or not manifest.cameras:
        raise UserError(f"{source}: expected a scene with frames and cameras, got none; export the run again")
    # Neighbouring views are stored one after the other, so that players, which blend them, need fewer requests.
    order = order_by_azimuth(manifest.source_cameras, manifest.focus) if manifest.source_cameras else []
    storage = Storage("zlib", tuple(order))
    if is_packed:
        transcode_scene(source, out, storage, track, has_normals=has_normals)
    else:
        pack_scene(source, out, tier, track, level=level, storage=storage, has_normals=has_normals)


def write_poster(scene: Path, out: Path) -> None:
    """Render the first frame from the first camera to a JPEG file."""
    draw_poster(scene, _POSTER_SIDE).save(out, quality=85)


def draw_poster(scene: Path, longest_side: int) -> Image.Image:
    """Render the first frame of a scene from the first camera, with the camera's number of pixels, or with fewer so
    that no side of the image is longer than ``longest_side``. Raises UserError."""
    reader = SceneReader(scene)
    try:
        camera = reader.manifest.cameras[0]
        camera = camera.rescale(min(1.0, longest_side / max(camera.width, camera.height)))
        pixels = Player().draw(reader.read(0), camera, reader.manifest, background=DEFAULT_BACKGROUND)
    finally:
        reader.close()
    return Image.fromarray(pixels[..., :3])


def copy_player(
    folder: Path,
    title: str,
    is_live: bool = False,
    styles: Mapping[str, Style] | None = None,
    url: str | None = None,
) -> None:
    """Copy the page and the player's modules, and write the styles that the player offers.

    If ``is_live`` is True, an open page loads the scene file again whenever it changes on the server. If ``styles`` is
    None, the page offers the presets. ``url`` is the address of the page, or None if it is not known.
    """
    copy_modules(folder, styles)
    with as_file(files("fourd.viewer") / "web") as web:
        page = (web / "index.html").read_text(encoding="utf-8")
        page = page.replace("{{preview}}", _preview(url))
        page = page.replace("{{scene}}", SCENE_NAME).replace("{{live}}", " live" if is_live else "")
        _write_page(folder, page, title, loaded_modules(folder))
        shutil.copyfile(web / "page.css", folder / "page.css")


def _preview(url: str | None) -> str:
    """Return the tags of the image that previews of links show. Its address must be absolute, so that there are no tags
    if the address of the page is not known."""
    if url is None:
        return ""
    base = html.escape(url if url.endswith("/") else f"{url}/", quote=True)
    tags = {"og:url": base, "og:image": f"{base}{POSTER_NAME}"}
    return "\n    ".join(f'<meta property="{name}" content="{value}" />' for name, value in tags.items())


def copy_modules(folder: Path, styles: Mapping[str, Style] | None = None) -> None:
    """Write only the folder of the player: its modules, and the styles that it offers. If ``styles`` is None, these are
    the presets."""
    with as_file(files("fourd.viewer") / "web") as web:
        _copy_modules(web, folder, styles, (*_NOT_SERVED, TRAINING_FOLDER))


def loaded_modules(folder: Path) -> list[str]:
    """The modules that a page with a player loads at once, relative to the folder in which :func:`copy_modules` wrote
    them."""
    modules = sorted(path.relative_to(folder).as_posix() for path in (folder / PLAYER_FOLDER).rglob("*.js"))
    return [name for name in modules if not name.endswith(("worker.js", "fourd-scene.js"))]


def copy_training_page(folder: Path, title: str, styles: Mapping[str, Style] | None = None) -> None:
    """Copy the page of a run and the JavaScript modules of the page and its player. If ``styles`` is None, the player
    offers the presets."""
    with as_file(files("fourd.viewer") / "web") as web:
        _copy_modules(web, folder, styles, _NOT_SERVED)
        page = (web / TRAINING_FOLDER / "index.html").read_text(encoding="utf-8")
        own = (folder / PLAYER_FOLDER / TRAINING_FOLDER).glob("*.js")
        _write_page(folder, page, title, sorted(path.relative_to(folder).as_posix() for path in own))
        shutil.copyfile(web / TRAINING_FOLDER / "page.css", folder / "page.css")


def _copy_modules(web: Path, folder: Path, styles: Mapping[str, Style] | None, left_out: Sequence[str]) -> None:
    shutil.copytree(web, folder / PLAYER_FOLDER, ignore=shutil.ignore_patterns(*left_out))
    write_styles(folder / PLAYER_FOLDER / STYLES_NAME, load_styles(()) if styles is None else styles)


def _write_page(folder: Path, page: str, title: str, modules: Sequence[str]) -> None:
    """Write a page with preload links for ``modules``. Without the links, a browser would request a module only after
    it has fetched another one that imports it. They have a low priority, because the poster comes first."""
    links = (f'<link rel="modulepreload" href="{name}" fetchpriority="low" />' for name in modules)
    page = page.replace("{{title}}", html.escape(title, quote=True)).replace("{{preload}}", "\n    ".join(links))
    (folder / PAGE_NAME).write_text(page, encoding="utf-8")
