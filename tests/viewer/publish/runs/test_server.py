"""The server of a run: its tokens, host names, origins and data, and the requests to the training."""

from __future__ import annotations

import http.client
import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.base.formats.picture import write_picture
from fourd.base.progress import Terminal
from fourd.cli.main import main
from fourd.reconstruction.training.live.control import ControlReader, ControlRequest
from fourd.reconstruction.training.live.session import LiveSession, StepCount
from fourd.reconstruction.training.live.state import read_state
from fourd.viewer.publish.runs import site as run_site
from fourd.viewer.publish.runs.access import Access, choose_token, is_loopback
from fourd.viewer.publish.runs.server import RunServer
from fourd.viewer.publish.runs.site import RunSite

TOKEN = "abcdefghijklmnop_-0123"
CONTROL = {"X-Fourd-Request": "control"}


@pytest.fixture(autouse=True)
def fresh_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disable the reuse of answers."""
    monkeypatch.setattr(run_site, "STATUS_SECONDS", 0.0)


@pytest.fixture
def run(tmp_path: Path, rng: np.random.Generator) -> Path:
    """A run with a log and a picture, without a checkpoint."""
    folder = tmp_path / "a run"
    folder.mkdir()
    (folder / "config.yaml").write_text("secret: true\n")
    (folder / "metrics.jsonl").write_text('{"step": 10, "psnr_smooth": 20.0}\n{"step": 10, "validation/psnr": 19.0}\n')
    write_picture(folder / "validation" / "0000010.png", rng.integers(0, 255, (20, 40, 3), np.uint8))
    return folder


@contextmanager
def serving(run: Path, token: str | None = None, host: str = "127.0.0.1") -> Iterator[RunServer]:
    folder = run.parent / "site"
    with RunServer(folder, Access(host, token)) as server:
        server.site = RunSite(run, folder, "light", Terminal(quiet=True))
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@contextmanager
def training(run: Path) -> Iterator[str]:
    """A training of the run, without steps. Yields its session."""
    with LiveSession(run, 100, True, Terminal(quiet=True)) as live:
        live.show(StepCount(25, 50.0, 0.25))
        state = read_state(run)
        assert state is not None
        yield state.session


def ask(
    server: RunServer, path: str, headers: dict[str, str] | None = None, method: str = "GET", body: Any = None
) -> tuple[int, dict[str, str], bytes]:
    """Status, headers and content of a response. The path is sent unchanged."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)
    content = body if isinstance(body, bytes | None) else json.dumps(body).encode()
    connection.request(method, path, content, headers or {})
    response = connection.getresponse()
    answer = response.read()
    connection.close()
    return response.status, dict(response.getheaders()), answer


def test_the_state_of_a_run(run: Path) -> None:
    """Catches wrong numbers on the page, and a page that does not show that the run has ended."""
    with serving(run) as server:
        page = ask(server, "/")[2].decode()
        assert "<title>a run</title>" in page
        assert "{{" not in page
        idle = json.loads(ask(server, "/run/status.json")[2])
        assert (idle["phase"], idle["step"], idle["psnr"], idle["validation_psnr"]) == ("idle", 10, 20.0, 19.0)
        assert idle["pictures"] == [10]
        with training(run):
            status = json.loads(ask(server, "/run/status.json")[2])
            assert (status["phase"], status["step"], status["max_steps"]) == ("training", 25, 100)
            assert status["remaining_seconds"] == 150.0
        ended = json.loads(ask(server, "/run/status.json")[2])
        assert (ended["phase"], ended["remaining_seconds"]) == ("finished", None)
        curves = json.loads(ask(server, "/run/curves.json")[2])
        assert curves["validation/psnr"] == {"step": [10.0], "value": [19.0]}
        scene = json.loads(ask(server, "/run/scene.json")[2])
        assert scene == {"state": "none", "step": -1, "message": "", "progress": None}


def test_unchanged_answers_are_not_sent_again(run: Path) -> None:
    """Catches a page that transfers all curves every second."""
    with serving(run) as server:
        for path in ("/run/status.json", "/run/curves.json", "/run/pictures/10.jpg"):
            status, headers, content = ask(server, path)
            assert (status, len(content) > 0) == (200, True)
            again, _, nothing = ask(server, path, {"If-None-Match": headers["ETag"]})
            assert (again, nothing) == (304, b"")
            assert ask(server, path, method="HEAD")[::2] == (200, b"")


def test_the_parts_of_a_run_with_segments(run: Path) -> None:
    """Catches a page that shows the last segment while another segment trains."""
    for index in range(3):
        with training(run / "segments" / f"{index:03d}"):
            pass
    with serving(run) as server:
        with training(run / "segments" / "001") as session:
            status = json.loads(ask(server, "/run/status.json")[2])
            assert (status["segment"], status["phase"], status["session"]) == (2, "training", session)
        write_picture(run / "segments" / "001" / "validation" / "0000007.png", np.zeros((4, 8, 3), np.uint8))
        assert ask(server, "/run/pictures/7.jpg?segment=2")[0] == 200
        for path in ("/run/pictures/7.jpg", "/run/pictures/7.jpg?segment=1", "/run/pictures/7.jpg?segment=../2"):
            assert ask(server, path)[0] == 404


@pytest.mark.parametrize(
    "path",
    [
        "/config.yaml",
        "/run/config.yaml",
        "/../a%20run/config.yaml",
        "/run/../config.yaml",
        "/run/pictures/../../config.yaml",
        "/run/pictures/..%2f..%2fconfig.yaml",
        "/run/pictures/9.jpg",
        "/run/pictures/-1.jpg",
        "/run/pictures/" + "1" * 5000 + ".jpg",
        "/run/",
        "/run/control",
        "/run/status.json/x?" + "&".join(f"a{i}=1" for i in range(50)),
    ],
)
def test_other_files_of_the_run_are_not_served(path: str, run: Path) -> None:
    """Catches a server that sends the config, or any other file that is named in the address."""
    with serving(run) as server:
        status, _, content = ask(server, path)
        assert status == 404
        assert b"secret" not in content


def test_damaged_pictures_are_not_found(run: Path) -> None:
    """Catches a traceback, and a picture that needs gigabytes of memory."""
    (run / "validation" / "0000011.png").write_bytes(b"no picture")
    header = (run / "validation" / "0000010.png").read_bytes()
    (run / "validation" / "0000012.png").write_bytes(header[:16] + bytes([0, 1, 0, 0] * 2) + header[24:])
    with serving(run) as server:
        assert [ask(server, f"/run/pictures/{step}.jpg")[0] for step in (10, 11, 12)] == [200, 404, 404]


def test_requests_to_the_training(run: Path) -> None:
    """Catches a button without effect, requests to a training that has ended, and requests to another training."""
    with serving(run) as server:

        def send(session: str, action: str) -> tuple[int, str]:
            body = {"session": session, "action": action}
            status, _, content = ask(server, "/run/control", CONTROL, "POST", body)
            return status, content.decode().strip()

        assert send("", "pause") == (409, "The run does not train, so that there is nothing to pause, save or stop.")
        with training(run) as session:
            reader = ControlReader(run, session)
            assert send(session, "pause") == (202, "{}")
            assert reader.read() == ControlRequest(session, "pause")
            assert send(session, "explode")[0] == 409
            assert send("another", "stop") == (
                409,
                "Another training of this run has started since this page was updated. Try again.",
            )
            assert reader.read() is None
        assert send(session, "resume")[0] == 409


@pytest.mark.parametrize(
    ("headers", "expected"),
    [
        ({}, 403),
        ({"X-Fourd-Request": "other"}, 403),
        ({**CONTROL, "Origin": "http://example.com"}, 403),
        ({**CONTROL, "Origin": "null"}, 403),
        ({**CONTROL, "Origin": "http://127.0.0.1:1"}, 403),
        ({**CONTROL, "Sec-Fetch-Site": "cross-site"}, 403),
        ({**CONTROL, "Sec-Fetch-Site": "same-site"}, 403),
        ({**CONTROL, "Host": "example.com"}, 403),
        ({**CONTROL, "Host": "127.0.0.1.example.com:8000"}, 403),
        ({**CONTROL, "Host": ""}, 403),
        ({**CONTROL, "Host": "localhost:1234", "Origin": "http://localhost:1234"}, 202),
        ({**CONTROL, "Sec-Fetch-Site": "same-origin"}, 202),
    ],
)
def test_pages_of_other_sites_cannot_stop_a_run(headers: dict[str, str], expected: int, run: Path) -> None:
    """Catches a page of another site that sends requests with the user's browser, also if the site's name resolves
    to this machine."""
    with serving(run) as server, training(run) as session:
        body = {"session": session, "action": "stop"}
        status, answer, content = ask(server, "/run/control", headers, "POST", body)
        assert status == expected
        assert "Access-Control-Allow-Origin" not in answer
        assert (run / "live" / "control.json").exists() == (expected == 202)
        assert len(content.splitlines()) == 1
        assert ask(server, "/run/control", method="OPTIONS")[0] == 501


@pytest.mark.parametrize(
    ("body", "path", "expected"),
    [
        (b"", "/run/control", 400),
        (b"{", "/run/control", 400),
        (b"[" * 1000, "/run/control", 400),
        (b"[]", "/run/control", 400),
        (b'{"session": 1, "action": "stop"}', "/run/control", 400),
        (b" " * 2000, "/run/control", 400),
        (b"{}", "/run/status.json", 404),
        (b"{}", "/", 404),
    ],
)
def test_malformed_requests(body: bytes, path: str, expected: int, run: Path) -> None:
    """Catches a traceback, and a request that is read into memory without a limit of its size."""
    with serving(run) as server, training(run):
        assert ask(server, path, CONTROL, "POST", body)[0] == expected
        assert not (run / "live" / "control.json").exists()


def test_a_token_is_needed_for_everything(run: Path) -> None:
    """Catches a page, picture or request that is answered without a token, and a token that stays in the address."""
    with serving(run, TOKEN) as server, training(run) as session:
        body = {"session": session, "action": "stop"}
        for path in ("/", "/run/status.json", "/run/pictures/10.jpg", "/player/fourd-player.js", "/none"):
            for given in ({}, {"Cookie": "a=b"}, {"Cookie": f"{server.cookie}={TOKEN[:-1]}x"}, {"Cookie": "x" * 9000}):
                status, _, content = ask(server, path, given)
                assert status == 403
                assert len(content.splitlines()) == 1
                assert TOKEN.encode() not in content
        wrong, answer, content = ask(server, "/?token=wrong")
        assert (wrong, content.decode().strip()[:19]) == (403, "The token is wrong.")
        assert "Set-Cookie" not in answer
        status, answer, _ = ask(server, f"//example.com/?token={TOKEN}&tab=scene")
        assert (status, answer["Location"]) == (303, "/example.com/?tab=scene")
        status, answer, _ = ask(server, f"/?token={TOKEN}&tab=scene")
        assert (status, answer["Location"]) == (303, "/?tab=scene")
        cookie, *attributes = answer["Set-Cookie"].split("; ")
        assert {"HttpOnly", "SameSite=Lax", "Path=/"} <= set(attributes)
        kept = {"Cookie": f"other=1; {cookie}"}
        assert ask(server, "/", {**kept, "Host": "studio.example:8000"})[0] == 200
        assert ask(server, "/run/status.json", kept)[0] == 200
        assert ask(server, "/run/control", CONTROL, "POST", body)[0] == 403
        assert ask(server, "/run/control", kept, "POST", body)[0] == 403
        assert ask(server, "/run/control", {**CONTROL, **kept}, "POST", body)[0] == 202


def test_frames_of_other_sites_show_nothing(run: Path) -> None:
    """Catches a page that another site shows in a frame below its own buttons, and addresses that reach other sites."""
    with serving(run) as server:
        for path in ("/", "/run/status.json", "/none", "/player/training/main.js"):
            headers = ask(server, path)[1]
            assert (headers["X-Frame-Options"], headers["Referrer-Policy"]) == ("DENY", "no-referrer")


def test_the_choice_of_a_token(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a server for all machines without a token, short tokens, and a message that contains the token."""
    monkeypatch.delenv("FOURD_TOKEN", raising=False)
    assert choose_token(None, "127.0.0.1") is None
    assert choose_token(None, "localhost") is None
    first, second = choose_token(None, "0.0.0.0"), choose_token(None, "192.168.1.5")
    assert first is not None
    assert len(first) >= 24
    assert first != second
    assert choose_token(TOKEN, "127.0.0.1") == TOKEN
    for wrong in ("", "short", "with space in the text", "ümlauts-in-the-token", "x" * 129):
        for option, variable in ((wrong, "FOURD_TOKEN"), (None, "--token")):
            monkeypatch.setenv("FOURD_TOKEN", wrong)
            with pytest.raises(UserError, match="expected 16 to 128 letters, digits, '-' or '_', got") as caught:
                choose_token(option, "127.0.0.1")
            assert variable not in str(caught.value)
            assert not wrong or wrong not in str(caught.value)
    monkeypatch.setenv("FOURD_TOKEN", TOKEN)
    assert choose_token(None, "0.0.0.0") == TOKEN
    assert [is_loopback(host) for host in ("127.0.0.9", "::1", "", "0.0.0.0", "example.com")] == [True] * 2 + [
        False
    ] * 3


def test_serving_a_run(run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a run that is refused before its first checkpoint, and a printed address without the token. Also catches
    errors of more than one line."""
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)

    def interrupted(server: RunServer) -> None:
        assert server.site is not None
        assert (server.folder / "index.html").exists()
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(RunServer, "serve_forever", interrupted)
        assert main(["serve", str(run), "--port", "0"]) == 0
        assert main(["serve", str(run), "--port", "0", "--host", "0.0.0.0"]) == 0
    assert "?token=" not in opened[0]
    assert len(opened[1].partition("?token=")[2]) >= 24
    printed = capsys.readouterr().err
    assert opened[1] in printed
    assert "from other machines: http://" in printed
    assert main(["serve", str(run), "--port", "0", "--token", "short"]) == 2
    error = capsys.readouterr().err.strip()
    assert "--token: expected 16 to 128 letters" in error
    assert len(error.splitlines()) == 1
    (run.parent / "scene.4dv").write_bytes(b"")
    assert main(["serve", str(run.parent / "scene.4dv"), "--token", TOKEN]) == 2
    assert "--token: expected a run, got" in capsys.readouterr().err


def test_the_scene_is_baked_only_for_a_page_that_asks(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches baking while no page shows the scene, and baking of each checkpoint of a run that trains. Also catches a
    page that shows the scene of an earlier checkpoint after training has ended."""
    site = RunSite(run, run.parent / "site", "light", Terminal(quiet=True))
    baked: list[str] = []
    progress: list[dict[str, Any]] = []

    def write() -> None:
        baked.append(site._scene._read_version())
        for _ in site._scene._track(range(5), 5, "pack"):
            progress.append(json.loads(site.scene())["progress"])
        deadline = time.process_time() + 0.05
        while time.process_time() < deadline:
            pass

    monkeypatch.setattr(site._scene, "_write", write)
    monkeypatch.setattr(run_site, "_POLL_SECONDS", 0.01)
    # 50 ms of baking allow the next baking after hours, so that a slow machine does not reach it.
    monkeypatch.setattr(run_site, "BAKING_SHARE", 1e-6)
    (run / "checkpoints").mkdir()
    (run / "checkpoints" / "00000010.safetensors").write_bytes(b"")
    thread = threading.Thread(target=site.watch, daemon=True)
    with training(run):
        thread.start()
        time.sleep(0.1)
        assert baked == []
        assert json.loads(site.scene())["state"] == "baking"
        while not baked or site._is_baking:
            time.sleep(0.01)
        (run / "checkpoints" / "00000020.safetensors").write_bytes(b"")
        assert json.loads(site.scene()) == {"state": "ready", "step": 10, "message": "", "progress": None}
        time.sleep(0.1)
        assert baked == ["00000010.safetensors"]
    deadline = time.monotonic() + 60
    while len(baked) < 2 or site._is_baking:
        assert time.monotonic() < deadline, "the last checkpoint is not baked"
        time.sleep(0.01)
    assert json.loads(site.scene())["step"] == 20
    assert progress[3] == {"work": "pack", "done": 3, "count": 5}
    site.stop()
    thread.join()
