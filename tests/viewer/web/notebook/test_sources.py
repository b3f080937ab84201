"""How the page asks the kernel for ranges, without a page: the module runs in Node."""

from __future__ import annotations

import json
import shutil
import subprocess
from typing import Any

import pytest

from tests.viewer.web.npm import WEB

pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="no node here")

SETUP = """
import { KernelSource } from "%s";
const content = Uint8Array.from({length: 3_000_000}, (_, index) => index %% 251);
const sent = [];
const model = {
    on: (name, listener) => (model.listener = listener),
    off: () => (model.listener = null),
    send: (message) => sent.push(message),
};
const answer = () => {
    const {id, offset, size} = sent.shift();
    model.listener({id}, [new DataView(content.slice(offset, offset + size).buffer)]);
    return offset;
};
const source = new KernelSource(model, "scene.4dv", content.length, () => {});
const pause = () => new Promise((resolve) => setTimeout(resolve));
const outcome = (promise) => promise.then((bytes) => bytes.length, (error) => `${error.name}: ${error.message}`);
"""


def run(script: str) -> Any:
    """Run a script in Node, and return the value that it prints."""
    code = SETUP % (WEB / "notebook" / "sources.js").as_uri() + script
    done = subprocess.run(["node", "--input-type=module", "-e", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_ranges_are_joined_in_order() -> None:
    """Catches parts of a range that are joined in the order of the answers, and a range beyond the end of the file."""
    script = """
        const reading = source.read(1_000_000, 5_000_000);
        sent.reverse();
        while (sent.length) { answer(); await pause(); }
        const bytes = await reading;
        const same = bytes.every((byte, index) => byte === content[1_000_000 + index]);
        console.log(JSON.stringify([bytes.length, same, source.rate.bytesPerSecond > 0]));
    """
    assert run(script) == [2_000_000, True, True]


def test_ranges_that_are_no_longer_needed_are_not_asked_for() -> None:
    """Playback stopped: each new frame aborted the requests of the frame before, but the kernel still answered all of
    them first, so that every answer came too late."""
    script = """
        const abort = new AbortController();
        const old = outcome(source.read(0, 3_000_000, abort.signal));
        const waiting = sent.length;
        abort.abort();
        const next = outcome(source.read(7, 11));
        const offsets = [];
        while (sent.length) { offsets.push(answer()); await pause(); }
        console.log(JSON.stringify([waiting, await old, await next, offsets]));
    """
    waiting, old, following, offsets = run(script)
    assert old == "AbortError: The range is no longer needed"
    assert (waiting, following) == (4, 11)
    assert offsets == [0, 1 << 19, 2 << 19, 3 << 19, 7]


def test_errors_of_the_kernel_reach_the_page() -> None:
    """Catches an error that leaves the page waiting, and short answers that are taken for whole ones."""
    script = """
        const first = outcome(source.read(0, 10));
        model.listener({id: sent.shift().id, error: "scene.4dv: changed"}, []);
        const second = outcome(source.read(0, 10));
        model.listener({id: sent.shift().id}, [new ArrayBuffer(3)]);
        const third = outcome(source.readExactly(2_999_999, 10));
        answer();
        const fourth = outcome(source.read(0, 10));
        source.release();
        console.log(JSON.stringify([await first, await second, await third, await fourth, model.listener]));
    """
    assert run(script) == [
        "Error: scene.4dv: changed",
        "Error: scene.4dv: expected 10 bytes, got 3; call fourd.show again",
        "Error: scene.4dv: expected at least 3000009 bytes, got 3000000; call fourd.show again",
        "Error: The player was closed",
        None,
    ]
