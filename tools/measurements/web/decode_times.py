"""Print a Markdown table of the times to decode a frame in the web player's worker and in native code.

    python tools/measurements/web/decode_times.py scene_full.4dv scene_stream.4dv scene_light.4dv

The worker and the native code decode the points, the spherical harmonics, and the source views that are blended for the
last camera of the scene. The browser uses one worker, and the native code uses one core. First, the program writes a
web page with a copy of the scene. A scene file is a ZIP archive. `fourd pack` compresses its members with Zstandard,
but the members of the page's copy are compressed with zlib, which browsers can decode. The worker and the native code
take turns decoding this copy. Afterwards, the native code alone decodes the original file (column "native, alone").
"""

from __future__ import annotations

import statistics
import tempfile
import time
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from fourd.scene import SceneReader
from fourd.scene.packed.members import COLOUR, POINTS, SH, decode_cloud, view_member
from fourd.viewer.publish.site import SCENE_NAME, write_site
from tools.measurements import tables
from tools.measurements.web.pages import open_pages

PREPARE = """async () => {
    const load = (name) => import(new URL(name, new URL("player/", location.href)));
    const {SceneFile} = await load("scene/scene_file.js");
    const {ByteSource} = await load("scene/byte_source.js");
    const {DecodePool} = await load("decode/pool.js");
    const {selectSourceViews} = await load("navigate/source_views.js");
    const file = await SceneFile.open(new ByteSource(new URL("scene.4dv", location.href).href, 15000));
    const {manifest} = file;
    const {views} = selectSourceViews(manifest.cameras.at(-1), manifest);
    const pool = new DecodePool(1);
    const encoding = manifest.dynamicEncoding;
    const total = () => pool.times.base[0] + pool.times.views[0];
    window.decodeFrame = async (frame) => {
        const folder = `frames/${String(frame).padStart(6, "0")}`;
        const points = manifest.points[frame];
        const viewNames = views.map((view) => `${folder}/views/${String(view).padStart(3, "0")}`);
        const names = [`${folder}/points`, `${folder}/sh`, ...(views.length ? [`${folder}/colour`] : [])];
        const found = await file.read([...names, ...viewNames]);
        const [pointsMember, sh, colour] = names.map((name) => found.get(name));
        const before = total();
        const members = {points: pointsMember, sh, colour: colour ?? null};
        const base = await pool.base({kind: "base", folder, points, encoding, members});
        const listed = views.map((view, index) => (
            {view, member: found.get(viewNames[index]), camera: manifest.sources[view]}));
        if (views.length) await pool.views({kind: "views", folder, encoding, mean: base.mean, xyz: base.xyz,
            views: listed});
        return total() - before;
    };
    document.querySelector("fourd-player").remove();
    return views;
}"""


@dataclass(frozen=True)
class Arguments:
    """The scenes to decode, and the number of repetitions."""

    scenes: tyro.conf.Positional[tuple[Path, ...]]
    """Packed scenes."""
    rounds: int = 5
    """Number of times that each frame is decoded."""


def main() -> None:
    arguments = tyro.cli(Arguments, description=__doc__)
    titles = ["scene", "points", "views", "worker: median", "10th to 90th percentile", "native: median", "ratio"]
    print(tables.head([*titles, "native, alone"]))
    for scene in arguments.scenes:
        with tempfile.TemporaryDirectory() as folder:
            site = Path(folder) / "site"
            write_site(scene, site, "full")
            print(tables.row(measure(scene, site, arguments.rounds)))


def measure(scene: Path, site: Path, rounds: int) -> list[str]:
    """Measure the times to decode the frames of a scene, and return its table row. The folder ``site`` contains the web
    page of the scene."""
    reader = SceneReader(site / SCENE_NAME)
    manifest = reader.manifest
    reader.close()
    worker: list[float] = []
    native: list[float] = []
    with open_pages({"page": (site, "")}, 256) as pages, zipfile.ZipFile(site / SCENE_NAME) as archive:
        page = pages["page"]
        views = page.evaluate(PREPARE)
        for _ in range(rounds + 1):
            for frame in range(manifest.frame_count):
                worker.append(page.evaluate("(frame) => decodeFrame(frame)", frame))
                native.append(decode_natively(archive, manifest, frame, views))
    with zipfile.ZipFile(scene) as archive:
        frames = [*range(manifest.frame_count)] * (rounds + 1)
        alone = [decode_natively(archive, manifest, frame, views) for frame in frames]
    # The times of the first round are dropped, because the browser compiles the JavaScript in this round.
    worker, native, alone = (times[manifest.frame_count :] for times in (worker, native, alone))
    steps = statistics.quantiles(worker, n=10)
    median, other = statistics.median(worker), statistics.median(native)
    points = max(manifest.points or (0,))
    in_worker = [f"{median:.1f} ms", f"{steps[0]:.1f} to {steps[-1]:.1f} ms"]
    native_times = [f"{other:.1f} ms", f"{median / other:.2f}", f"{statistics.median(alone):.1f} ms"]
    return [scene.stem, f"{points:,}", f"{len(views)}", *in_worker, *native_times]


def decode_natively(archive: zipfile.ZipFile, manifest: Any, frame: int, views: list[int]) -> float:
    """Decode a frame from the same members (files) of the archive that the web worker reads for it: the points, the
    spherical harmonics and the source views ``views``. Return the time in milliseconds."""
    folder = f"frames/{frame:06d}"
    names = [POINTS, SH, *([COLOUR] if views else [])]
    members = {name: archive.read(f"{folder}/{name}") for name in names}
    for index, view in enumerate(views):
        members[view_member(index)] = archive.read(f"{folder}/{view_member(view)}")
    cameras = [manifest.source_cameras[view] for view in views]
    started = time.perf_counter()
    decode_cloud(members, manifest.points[frame], cameras, manifest.encoding.dynamic)
    return 1000 * (time.perf_counter() - started)


if __name__ == "__main__":
    main()
