"""Tests of ``fourd make --work URL``: results are shared through a local S3 server, and each machine has its own local
copy."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Event

import pytest

from fourd.base.errors import UserError
from fourd.base.storage import StorageUrl
from fourd.cli.main import main
from fourd.pipeline.fetch import FetchSettings
from fourd.pipeline.stage import Context, Stage
from fourd.pipeline.stored.cache import CACHE_VARIABLE, Cache, Started, cache_folder
from fourd.pipeline.stored.manifest import FileEntry, Manifest, parse_manifest
from fourd.pipeline.stored.unit import UnitFiles, unit_stage
from fourd.pipeline.stored.work_store import WorkStore
from tests.captures import write_ball_capture
from tests.matting.captures import write_capture_without_masks, write_video
from tests.pipeline.test_stage import copy_stage
from tests.storage.s3_server import Bucket, put_folder, unfinished_uploads
from tools.measurements.cluster.local_nodes import PATIENT, TRAINED, LocalNodes, local_nodes

OVERLAY = """\
points: 500
model: {hidden: 8, planes: {levels: 1, features: 4, base_resolution: 8}}
"""
SEGMENTS = ("--segment", "4", "--set", "segments.overlap=1")

KILLED_IN_UPLOAD = """
import os, signal, sys
import fourd.base.storage.connection, fourd.base.storage.uploading
from fourd.cli.main import main

send, sent = fourd.base.storage.uploading._upload, []

def upload(store, path, url, track):
    if "/units/carve/" in str(url):
        sent.append(url)
        if len(sent) == 3:
            os.kill(os.getpid(), signal.SIGKILL)
    send(store, path, url, track)

fourd.base.storage.uploading._upload = upload
fourd.base.storage.connection.CONNECTIONS = 1
main(sys.argv[1:])
"""


class Machines:
    """Machines that share only a bucket. Each machine has its own working folder and its own local copy."""

    def __init__(self, bucket: Bucket, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.work = StorageUrl(f"{bucket.url}/work")
        self.folder = folder
        self._monkeypatch = monkeypatch

    def enter(self, name: str) -> Path:
        """Use the machine ``name`` from now on. Returns its working folder."""
        here = self.folder / name
        here.mkdir(exist_ok=True)
        (here / "small.yaml").write_text(OVERLAY)
        self._monkeypatch.chdir(here)
        self._monkeypatch.setenv(CACHE_VARIABLE, str(here / "cache"))
        return here

    def words(self, source: object, out: object, *options: object) -> list[str]:
        words = ["make", source, "-o", out, "--config", "small.yaml", "--max-steps", 2, "--work", self.work]
        return [str(word) for word in (*words, *options)]

    def make(self, source: object, out: object, *options: object) -> None:
        assert main(self.words(source, out, *options)) == 0


@pytest.fixture
def machines(bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machines:
    return Machines(bucket, tmp_path, monkeypatch)


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture of a ball: 4 cameras, 7 frames, 48 x 48."""
    return write_ball_capture(tmp_path_factory.mktemp("ball"), cameras=4, frames=7, size=48)


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of videos with a calibration and without masks."""
    folder = tmp_path_factory.mktemp("videos")
    capture, source = write_capture_without_masks(folder, frames=6, size=64), folder / "videos"
    source.mkdir()
    for name in ("intri.yml", "extri.yml"):
        shutil.copy(capture / name, source / name)
    for images in (capture / "images").iterdir():
        write_video(source / f"{images.name}.mp4", sorted(images.iterdir()))
    return source


def states(printed: str) -> dict[str, str]:
    """The state of each stage by name: "running" or "up to date"."""
    lines = [line.partition(": ") for line in printed.splitlines()]
    return {name: state for name, _, state in lines if state in ("running", "up to date")}


@pytest.mark.slow
def test_an_empty_machine_reuses_finished_stages(
    bucket: Bucket, machines: Machines, videos: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches keys and files that depend on the folder of the local copy, lost links of an import, and modification
    times that are not restored. Also catches a scene that differs from the scene made in a local folder.
    """
    put_folder(bucket.files, videos, f"{bucket.name}/videos")
    source = f"{bucket.url}/videos"
    first = machines.enter("first")
    assert (
        main([word for word in machines.words(source, "local.4dv") if word not in ("--work", str(machines.work))]) == 0
    )
    machines.make(source, "scene.4dv")
    assert (first / "scene.4dv").read_bytes() == (first / "local.4dv").read_bytes()
    assert not (first / "scene.work").exists()
    capsys.readouterr()
    second = machines.enter("second")
    machines.make(source, "other.4dv")
    names = ("import", "check", "repair", "mattes", "plates", "colours", "carve", "train", "bake")
    assert states(capsys.readouterr().out) == dict.fromkeys(names, "up to date")
    assert (second / "other.4dv").read_bytes() == (first / "scene.4dv").read_bytes()
    words = machines.words(source, f"{bucket.url}/scene.4dv", "--set", "rates.planes=1e-3")
    assert main(words) == 2
    assert "the finished run of 2 steps in this folder, got others (rates.planes: " in capsys.readouterr().err
    assert main([*words, "--force"]) == 0
    found = states(capsys.readouterr().out)
    assert [name for name in names if found[name] == "running"] == ["train", "bake"]
    machines.enter("first")
    machines.make(source, "scene.4dv", "--set", "rates.planes=1e-3")
    assert set(states(capsys.readouterr().out).values()) == {"up to date"}
    assert (first / "scene.4dv").read_bytes() == bucket.files.cat_file(f"{bucket.name}/scene.4dv")


@pytest.mark.slow
def test_segments_of_an_earlier_division_are_removed(
    bucket: Bucket, machines: Machines, ball: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches stale segments in the store or in a local copy, which would be baked into the scene."""
    put_folder(bucket.files, ball, f"{bucket.name}/ball")
    source = f"{bucket.url}/ball"
    first = machines.enter("first")
    machines.make(source, "scene.4dv", *SEGMENTS)
    segments = cache_folder(machines.work) / "run" / "segments"
    assert sorted(path.name for path in segments.iterdir()) == ["000", "001"]
    machines.enter("second")
    assert main(machines.words(source, "scene.4dv")) == 2, "the segments would be lost"
    machines.make(source, "scene.4dv", "--force")
    units = {path.split("/")[3] for path in bucket.files.find(f"{bucket.name}/work/units")}
    assert "train" in units
    assert "train-000" not in units
    machines.enter("first")
    machines.make(source, "scene.4dv")
    assert not list(segments.glob("*"))
    assert (first / "scene.4dv").read_bytes() == (machines.folder / "second" / "scene.4dv").read_bytes()
    capsys.readouterr()
    capsys.readouterr()
    machines.make(source, "scene.4dv", *SEGMENTS, "--force")
    assert states(capsys.readouterr().out)["train 001"] == "running"


def test_a_kill_in_the_middle_of_an_upload_leaves_the_old_result(
    bucket: Bucket, machines: Machines, ball: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches results that mix the files of two executions, and files of a killed upload that stay in the store."""
    put_folder(bucket.files, ball, f"{bucket.name}/ball")
    source, options = f"{bucket.url}/ball", ("--points", 400, "--force")
    machines.enter("first")
    machines.make(source, "scene.4dv")
    objects = set(bucket.files.find(f"{bucket.name}/work/units/carve"))
    words = [sys.executable, "-c", KILLED_IN_UPLOAD, *machines.words(source, "scene.4dv", *options)]
    assert subprocess.run(words, env={**os.environ}).returncode == -signal.SIGKILL
    after = set(bucket.files.find(f"{bucket.name}/work/units/carve"))
    assert objects < after
    assert len(after - objects) == 2
    capsys.readouterr()
    machines.enter("second")
    machines.make(source, "scene.4dv")
    assert set(states(capsys.readouterr().out).values()) == {"up to date"}
    assert set(bucket.files.find(f"{bucket.name}/work/units/carve")) == objects
    machines.make(source, "scene.4dv", *options)
    assert states(capsys.readouterr().out)["carve"] == "running"
    assert not objects & set(bucket.files.find(f"{bucket.name}/work/units/carve"))
    assert unfinished_uploads(bucket.files, bucket.name) == []


def test_a_stage_with_missing_objects_runs_again(
    bucket: Bucket, machines: Machines, ball: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a folder that can never be used again after an object was deleted."""
    machines.enter("first")
    machines.make(ball, "scene.4dv")
    (hull,) = bucket.files.glob(f"{bucket.name}/work/units/carve/*/run/hull/000003.ply")
    bucket.files.rm_file(hull)
    machines.enter("second")
    capsys.readouterr()
    machines.make(ball, "scene.4dv")
    found = states(capsys.readouterr().out)
    others = ("check", "repair", "colours", "train", "bake")
    assert found == {"carve": "running"} | dict.fromkeys(others, "up to date")


@pytest.mark.slow
def test_the_frame_rate_reaches_other_machines(
    bucket: Bucket, machines: Machines, ball: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a frame rate that only the machine knows on which the command was started."""
    put_folder(bucket.files, ball, f"{bucket.name}/ball")
    first = machines.enter("first")
    machines.make(f"{bucket.url}/ball", "scene.4dv", "--fps", 25)
    second = machines.enter("second")
    capsys.readouterr()
    machines.make(f"{bucket.url}/ball", "scene.4dv", "--fps", 25)
    assert set(states(capsys.readouterr().out).values()) == {"up to date"}
    assert main(["info", "scene.4dv"]) == 0
    assert "25" in capsys.readouterr().out
    assert (first / "scene.4dv").read_bytes() == (second / "scene.4dv").read_bytes()


@pytest.mark.slow
def test_a_cluster_without_shared_paths(
    bucket: Bucket, machines: Machines, ball: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a node that needs a path of another machine, and results that stay on the node that made them. Also
    catches a lost worker whose stage is not repeated on another worker.
    """
    pytest.importorskip("ray", reason="needs ray (pip install 'fourd[cluster]')")
    put_folder(bucket.files, ball, f"{bucket.name}/ball")
    killed: list[str] = []
    finished = Event()

    def kill_a_worker(nodes: LocalNodes) -> None:
        while not killed and not finished.wait(0.1):
            for pid, name in nodes.stages().items():
                if name.startswith(TRAINED):
                    os.kill(pid, signal.SIGKILL)
                    killed.append(name)
                    break

    with local_nodes(0, 1, patience=PATIENT) as nodes:
        for name in ("one", "two"):
            machines.enter(name)
            nodes.add()
        driver = machines.enter("driver")
        with ThreadPoolExecutor(1) as pool:
            killing = pool.submit(kill_a_worker, nodes)
            try:
                machines.make(f"{bucket.url}/ball", "scene.4dv", *SEGMENTS, "--ray", nodes.address)
            finally:
                finished.set()
            killing.result()
    assert len(killed) == 1
    assert not (cache_folder(machines.work) / "run" / "segments").exists(), "the driver needs no segments"
    made = [
        path.name for name in ("one", "two") for path in (machines.folder / name).glob("cache/work/*/run/segments/*")
    ]
    assert {"000", "001"} <= set(made)
    machines.enter("other")
    capsys.readouterr()
    machines.make(f"{bucket.url}/ball", "scene.4dv", *SEGMENTS)
    assert set(states(capsys.readouterr().out).values()) == {"up to date"}
    assert Path("scene.4dv").read_bytes() == (driver / "scene.4dv").read_bytes()


def _store_with_source(machines: Machines, folder: Path) -> tuple[WorkStore, Path]:
    """Open the store on the first machine, and write the source file of the stages. Returns the store and the folder of
    its local copy."""
    machines.enter("first")
    store = WorkStore(machines.work)
    store.open()
    (folder / "source").write_text("text")
    return store, cache_folder(machines.work)


def test_an_interrupted_stage_resumes_on_its_machine(machines: Machines, tmp_path: Path) -> None:
    """Catches finished files of an interrupted stage that are not published, and files of other settings that are."""
    store, root = _store_with_source(machines, tmp_path)

    def execute(key: str, fails: bool) -> None:
        source = tmp_path / ("missing" if fails else "source")
        stage = copy_stage(source, root / "a")
        files = UnitFiles(stage, root, store, tmp_path, ())
        unit_stage(files, key).run(Context())

    for key in ("old", "new"):
        with pytest.raises(FileNotFoundError):
            execute(key, fails=True)
        (root / "a" / f"{key} half").write_text("half the work")
    execute("new", fails=False)
    manifest = store.read("a")
    assert manifest is not None
    assert sorted(manifest.files) == ["a/copy", "a/new half"]


def test_kept_files_of_another_key_are_published(machines: Machines, tmp_path: Path) -> None:
    """Catches mattes that a stage keeps after a change of a setting, but that other machines then lack."""
    store, root = _store_with_source(machines, tmp_path)
    stage = replace(copy_stage(tmp_path / "source", root / "a"), leftovers=())

    def execute(key: str) -> set[str]:
        unit_stage(UnitFiles(stage, root, store, tmp_path, ()), key).run(Context())
        manifest = store.read("a")
        assert manifest is not None
        return set(manifest.files)

    assert execute("one") == {"a/copy"}
    (root / "a" / "kept").write_text("by the stage")
    (root / "other").write_text("not by the stage")
    assert execute("two") == {"a/copy"}
    cache = Cache(root)
    started = Started("three", {"other": cache.states([root])["other"]}, ())
    cache.mark_started("a", started)
    assert execute("four") == {"a/copy", "a/kept"}
    assert execute("five") == {"a/copy", "a/kept"}


def test_other_folders_and_states_are_refused(
    bucket: Bucket, machines: Machines, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches tracebacks, and objects of the user that are taken for results."""
    machines.enter("first")
    store, url = WorkStore(machines.work), machines.work
    bucket.files.pipe_file(f"{bucket.name}/work/mine.txt", b"mine")
    with pytest.raises(
        UserError, match=f"^{url}: expected a folder made by fourd make, got a folder with other objects"
    ):
        store.open()
    bucket.files.rm_file(f"{bucket.name}/work/mine.txt")
    store.open()
    stage = copy_stage(tmp_path / "source", cache_folder(url) / "a")
    missing = UnitFiles(stage, cache_folder(url), store, tmp_path / "capture", ())
    with pytest.raises(
        UserError, match=r"capture: expected the source of fourd make, got no such file or folder; mount"
    ):
        unit_stage(missing, "key").run(Context())
    other = UnitFiles(stage, cache_folder(url), store, tmp_path, (("check", "key"),))
    with pytest.raises(UserError, match=f"^{url}: expected the results of stage check of this command, got those of"):
        unit_stage(other, "key").run(Context())
    put = FetchSettings(f"{bucket.url}/work", "another version")
    with pytest.raises(UserError, match=f"^{url}: expected objects that stay the same while fourd make runs"):
        unit_stage(UnitFiles(stage, cache_folder(url), store, put, ()), "key").run(Context())
    assert main(["make", str(tmp_path), "-o", "a.4dv", "--work", "s3://no-such-bucket/work"]) == 2
    assert capsys.readouterr().err == (
        "fourd make: s3://no-such-bucket/work/work.json: expected an existing bucket and object, got 'The specified "
        "bucket does not exist'; check the bucket and the name\n"
    )


@pytest.mark.parametrize(
    ("files", "links"),
    [
        ({"../a": FileEntry(1, 1)}, {}),
        ({"/a": FileEntry(1, 1)}, {}),
        ({}, {"run/hull": "/home"}),
        ({}, {"capture/.fourd": "/home"}),
        ({}, {"capture/images": "../home"}),
    ],
)
def test_names_outside_the_folder_are_refused(files: dict[str, FileEntry], links: dict[str, str]) -> None:
    """Catches a manifest that writes to files outside the local copy."""
    content = Manifest("carve", "key", "0a", files, links).to_json().encode()
    with pytest.raises(UserError, match=r"^s3://b/carve.json: expected names of files of fourd make, got other names"):
        parse_manifest(content, StorageUrl("s3://b/carve.json"))


@pytest.mark.parametrize("content", [b"", b"[1]", b'{"version": 2}', b"\xff"])
def test_damaged_manifests_are_refused(content: bytes) -> None:
    """Catches a traceback for an object that is no manifest."""
    with pytest.raises(UserError, match=r"^s3://b/carve.json: expected"):
        parse_manifest(content, StorageUrl("s3://b/carve.json"))


def test_keys_depend_on_places_outside_the_local_copy_only(tmp_path: Path) -> None:
    """Catches a key of a stage that is the same for two sources, or that differs on two machines."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "source").write_text("text")
        os.utime(tmp_path / name / "source", ns=(5, 5))

    def key(name: str, root: str | None) -> str:
        stage: Stage = copy_stage(tmp_path / name / "source", tmp_path / name / "target")
        return stage.key({}, None if root is None else tmp_path / root)

    assert key("a", "a") == key("b", "b")
    assert key("a", "b") != key("b", "a")
    assert key("a", None) == key("a", "b")
