"""The sound of the web player: when it is heard, and how far it is from the picture."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.viewer.publish.site import write_site
from tests.sound.claps import write_clap_scene
from tests.sound.test_ogg import bomb
from tests.viewer.web.conftest import serving
from tests.viewer.web.page import PlayerPage
from tests.viewer.web.sound.listening import AT, lags_ms, listen, open_listening, seek_before_the_clap

MAX_LAG_MS = 40
BUTTON = "Sound (M)"


@pytest.fixture(scope="module")
def clap_site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site of a scene of 2 s with a clap. Tests must not change it."""
    folder = tmp_path_factory.mktemp("clap")
    write_clap_scene(folder / "scene.4dv", at=AT, start=0.25)
    write_site(folder / "scene.4dv", folder / "site", "full")
    return folder / "site"


@pytest.fixture
def page(browser: Any, clap_site: Path) -> Iterator[PlayerPage]:
    """The page of the scene, which plays without sound."""
    with serving(clap_site) as server:
        yield from open_listening(browser, server.url)


def is_playing(page: PlayerPage) -> bool:
    return bool(page.run("return stage.playback.sound.isPlaying;"))


def test_the_clap_is_heard_when_it_is_seen(page: PlayerPage) -> None:
    """Catches sound that is not at the time of the picture at the start, after loops, and after seeks."""
    listen(page)
    page.page.get_by_role("button", name=BUTTON).click()
    page.wait("flashes.length >= 5 && onsets.length >= 4")
    for _ in range(4):
        seek_before_the_clap(page)
    lags = np.array(lags_ms(page))
    assert len(lags) >= 8
    # The first flash can be before the sound is loaded. A busy machine draws single images late.
    assert abs(np.median(lags[1:])) <= MAX_LAG_MS
    assert page.problems == []


def test_sound_is_off_until_it_is_wanted(page: PlayerPage) -> None:
    """Catches sound that starts by itself, a button without a name or a state, and a pause that is not silent."""
    button = page.page.get_by_role("button", name=BUTTON, pressed=False)
    assert button.is_visible()
    assert page.run("return [stage.playback.sound.context, onsets.length];") == [None, 0]
    button.click()
    page.wait("stage.playback.sound.isPlaying")
    assert page.page.get_by_role("button", name=BUTTON, pressed=True).is_visible()
    page.page.keyboard.press("m")
    page.wait("!stage.playback.sound.isPlaying")
    page.page.keyboard.press("m")
    page.wait("stage.playback.sound.isPlaying")
    page.page.keyboard.press("Space")
    page.wait("!stage.playback.sound.isPlaying")
    page.page.keyboard.press("Space")
    page.wait("stage.playback.sound.isPlaying")
    page.run("stage.clock.speed = 2;")
    page.wait("stage.playback.sound.isPlaying && stage.playback.sound.source.playbackRate.value > 1.9")


def test_play_switches_the_sound_on_unless_it_is_muted(page: PlayerPage) -> None:
    """Catches a player whose Play button, which is a click, plays without sound, and one that ignores the user."""
    play = page.page.get_by_role("button", name="Play or pause (Space)")
    play.click()
    play.click()
    page.wait("stage.playback.sound.isPlaying")
    page.page.get_by_role("button", name=BUTTON).click()
    play.click()
    play.click()
    page.wait("stage.clock.isPlaying && !stage.playback.isBuffering")
    assert not is_playing(page)
    page.run("player.soundButton.chosen = null; player.setAttribute('muted', '');")
    play.click()
    play.click()
    page.wait("stage.clock.isPlaying && !stage.playback.isBuffering")
    assert not is_playing(page)


def test_a_scene_without_sound_has_no_button(play: PlayerPage) -> None:
    """Catches a button that does nothing."""
    assert not play.page.get_by_role("button", name=BUTTON).is_visible()
    play.page.keyboard.press("m")
    assert play.problems == []


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda sound: sound[: len(sound) // 2], "expected Opus in a complete Ogg file"),
        (lambda sound: b"RIFF" * 200, "expected Opus in a complete Ogg file"),
        (lambda sound: bomb(3600), "expected 1.75 s, got 3600 s"),
    ],
)
def test_broken_sound_is_a_note(
    clap_site: Path, tmp_path: Path, browser: Any, make: Callable[[bytes], bytes], words: str
) -> None:
    """Catches a page that stops because its sound is damaged, or whose memory is filled by it."""
    site = tmp_path / "site"
    site.mkdir()
    for path in clap_site.rglob("*"):
        target = site / path.relative_to(clap_site)
        target.mkdir() if path.is_dir() else target.write_bytes(path.read_bytes())
    whole = (clap_site / "scene.4dv").read_bytes()
    start = 30 + int.from_bytes(whole[26:28], "little") + int.from_bytes(whole[28:30], "little")
    size = int.from_bytes(whole[22:26], "little")
    keys = json.loads(whole[start : start + size])
    offset, length = keys["members"]["sound.ogg"]
    content = make(whole[offset : offset + length])
    keys["members"]["sound.ogg"] = [len(whole), len(content)]
    text = json.dumps(keys, separators=(",", ":")).encode().ljust(size)
    (site / "scene.4dv").write_bytes(whole[:start] + text + whole[start + size :] + content)
    with serving(site) as server:
        for page in open_listening(browser, server.url):
            page.page.get_by_role("button", name=BUTTON).click()
            page.wait("!player.panel.message.hidden")
            assert page.message().startswith("The scene has no sound here: ")
            assert words in page.message()
            assert page.run("return stage.clock.isPlaying;")
            assert not is_playing(page)
            assert page.page.get_by_role("button", name=BUTTON, pressed=False).is_visible()
