"""The page of a run in a browser: its curves, pictures and buttons, reloads of the page, and restarts of the server."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.base.formats.picture import write_picture
from fourd.base.progress import Terminal
from fourd.reconstruction.training.live.control import ControlReader
from fourd.reconstruction.training.live.session import LiveSession, StepCount
from fourd.reconstruction.training.live.state import read_state
from fourd.viewer.publish.runs import site as run_site
from fourd.viewer.publish.runs.access import Access
from fourd.viewer.publish.runs.server import RunHandler, RunServer
from fourd.viewer.publish.runs.site import RunSite
from fourd.viewer.publish.site import SCENE_NAME, write_scene
from tests.baking.scenes import write_scene as write_random_scene
from tests.viewer.web.page import TIMEOUT_MS

TOKEN = "abcdefghijklmnop_-0123"


@pytest.fixture(autouse=True)
def normal_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bake with the priority of the tests: with the lowest one, other programs could delay it past the timeouts."""
    monkeypatch.setattr(run_site, "_NICE", 0)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The files of a run of 400 steps."""
    folder = tmp_path / "fox"
    folder.mkdir()
    lines = []
    for step in range(10, 401, 10):
        values = {"psnr": 20 + step / 50, "psnr_smooth": 19 + step / 50, "loss/image": 1 / step, "loss/mask": 0.0}
        lines.append(json.dumps({"step": step, **values}))
    lines.extend(json.dumps({"step": step, "validation/psnr": 18 + step / 100}) for step in (100, 200, 300))
    (folder / "metrics.jsonl").write_text("\n".join(lines) + "\n")
    for step in (100, 200):
        write_picture(folder / "validation" / f"{step:07d}.png", np.full((20, 40, 3), step, np.uint8))
    return folder


@contextmanager
def serving(run: Path, folder: Path, port: int = 0, token: str | None = None) -> Iterator[RunServer]:
    with RunServer(folder, Access("127.0.0.1", token), port) as server:
        site = server.site = RunSite(run, folder, "light", Terminal(quiet=True))
        threads = [
            threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True),
            threading.Thread(target=site.watch, daemon=True),
        ]
        for thread in threads:
            thread.start()
        yield server
        site.stop()
        server.shutdown()
        for thread in threads:
            thread.join()


@pytest.fixture
def open_run(browser: Any) -> Iterator[Callable[..., Any]]:
    """A function that opens the page of a run. The page's errors are in its attribute `problems`."""
    contexts = []

    def open_one(url: str, width: int = 390) -> Any:
        contexts.append(browser.new_context(viewport={"width": width, "height": 800}))
        page = contexts[-1].new_page()
        page.problems = []
        page.on("pageerror", lambda error: page.problems.append(str(error)))
        page.on("dialog", lambda dialog: dialog.accept())
        page.goto(url)
        return page

    yield open_one
    for context in contexts:
        context.close()


def wait_for(page: Any, selector: str, text: str) -> None:
    """Wait until an element contains a text."""
    script = "([selector, text]) => document.querySelector(selector)?.textContent.includes(text)"
    page.wait_for_function(script, arg=[selector, text], timeout=TIMEOUT_MS)


def show_again(page: Any) -> None:
    """Tell the page that its tab is shown again. It then asks the server at once, and not only after its next pause."""
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")


def wait_for_curves(page: Any, chart: str, count: int) -> None:
    """Wait until a chart draws this number of curves. The page requests the curves after the state of the run."""
    script = "([selector, count]) => document.querySelectorAll(selector).length === count"
    page.wait_for_function(script, arg=[f"{chart} path", count], timeout=TIMEOUT_MS)


def test_a_run_is_watched_and_controlled(run: Path, tmp_path: Path, open_run: Callable[..., Any]) -> None:
    """Catches curves without values, a page that is wider than a phone, and buttons that send another request. Also
    catches a page that does not show the end of the training."""
    with serving(run, tmp_path / "site") as server:
        with LiveSession(run, 1000, True, Terminal(quiet=True)) as live:
            live.show(StepCount(400, 120.0, 0.4))
            state = read_state(run)
            assert state is not None
            requests = ControlReader(run, state.session)
            page = open_run(server.url)
            wait_for(page, "#numbers", "400 of 1,000")
            for text in ("21.00 dB", "27.00 dB", "0:02:00", "0:03:00"):
                wait_for(page, "#numbers", text)
            wait_for(page, "#pictures span", "Step 200")
            assert page.evaluate("document.documentElement.scrollWidth") <= 390
            wait_for_curves(page, ".chart:first-child", 3)
            box = page.locator(".plot").first.bounding_box()
            page.mouse.move(box["x"] + box["width"] - 10, box["y"] + 50)
            wait_for(page, ".values", "step 400")
            wait_for(page, ".values", "held-out views: 21 (step 300)")
            losses = page.locator(".chart").last
            wait_for_curves(page, ".chart:last-child", 1)  # a logarithmic axis does not show zeros
            losses.locator("input").last.uncheck()
            wait_for_curves(page, ".chart:last-child", 2)
            page.locator("#pause").click()
            wait_for(page, "#note", "Waiting for the end of the step")
            assert getattr(requests.read(), "action", None) == "pause"
            live.show(StepCount(401, 121.0, 0.4), "paused")
            wait_for(page, "#phase", "paused")
            page.reload()
            wait_for(page, "#pause", "Resume")
            wait_for_curves(page, ".chart:last-child", 2)  # the page keeps the choice of the axis
            assert page.locator("#save").is_disabled()
            page.locator("#pause").click()
            wait_for(page, "#note", "Resuming")
            assert getattr(requests.read(), "action", None) == "resume"
            live.show(StepCount(401, 121.0, 0.4))
            wait_for(page, "#phase", "training")
            page.locator("#stop").click()
            wait_for(page, "#note", "Stopping")
            assert getattr(requests.read(), "action", None) == "stop"
        wait_for(page, "#phase", "finished")
        assert page.locator("#stop").is_disabled()
        assert page.problems == []


def test_a_restarted_server_and_its_token(
    run: Path, tmp_path: Path, open_run: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a page that does not continue after a restart of the server, and a token that stays in the address. Also
    catches a wrong token that is not reported."""
    # Without this, the threads of a stopped server would answer on connections that the browser keeps open.
    monkeypatch.setattr(RunHandler, "protocol_version", "HTTP/1.0")
    with serving(run, tmp_path / "site", token=TOKEN) as server:
        port = server.server_address[1]
        page = open_run(server.page, 1000)
        wait_for(page, "#phase", "not training")
        assert page.url == server.url
        assert page.evaluate("document.cookie") == ""
    show_again(page)
    wait_for(page, "#problem", "The server does not answer.")
    with serving(run, tmp_path / "again", port, TOKEN[::-1]):
        show_again(page)
        wait_for(page, "#problem", "The token is wrong. Open the address that fourd serve has printed")
    with serving(run, tmp_path / "third", port, TOKEN):
        show_again(page)
        page.wait_for_function("() => document.querySelector('#problem').hidden", timeout=TIMEOUT_MS)
    assert page.problems == []


def test_the_scene_of_a_run(
    run: Path, tmp_path: Path, open_run: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a tab without a player, a tab that is lost when the page is reloaded, and a scene that stays old. Also
    catches a tab that shows no progress until the first scene."""
    points, wait_for_progress = iter((50, 70)), threading.Event()
    with serving(run, tmp_path / "site") as server:
        assert server.site is not None

        def write() -> None:
            if not (server.folder / SCENE_NAME).exists():
                scene = server.site._scene
                for done in scene._track(range(3), 3, "pack"):
                    if done == 2:  # 70% of the time is that of baking
                        wait_for_progress.wait()
            write_random_scene(tmp_path / "scene.4dv", frames=2, points=next(points))
            write_scene(tmp_path / "scene.4dv", tmp_path / "packed.4dv", "light")
            (tmp_path / "packed.4dv").replace(server.folder / SCENE_NAME)

        monkeypatch.setattr(server.site._scene, "_write", write)
        page = open_run(server.url)
        page.locator("#show-scene").click()
        wait_for(page, "#scene-note", "The run has no checkpoint yet.")
        (run / "checkpoints").mkdir()
        for count, step in ((50, 10), (70, 1020)):
            (run / "checkpoints" / f"{step:08d}.safetensors").write_bytes(b"")
            if count == 50:
                wait_for(page, "#scene-note", "is being made … (90%)")
                assert page.locator("#scene-progress").evaluate("bar => bar.value") == pytest.approx(0.9)
                wait_for_progress.set()
            wait_for(page, "#scene-note", f"Scene of step {step:,}.")
            shown = f"() => document.querySelector('fourd-player')?.stage?.manifest.points[0] === {count}"
            page.wait_for_function(shown, timeout=TIMEOUT_MS)
        page.reload()
        page.wait_for_function("() => document.querySelector('fourd-player')?.firstImageMs > 0", timeout=TIMEOUT_MS)
        page.locator("#show-training").click()
        assert page.locator("fourd-player").count() == 0
        assert page.problems == []
