"""Measures, in a browser, the time between the picture and the sound of a clap."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tests.viewer.web.page import PlayerPage

TAP = """
const connect = AudioNode.prototype.connect;
const taps = new WeakMap();
globalThis.onsets = [];
// Finds the first loud sample after 50 ms of silence, with the time of the context at which it is rendered.
const code = `registerProcessor("onsets", class extends AudioWorkletProcessor {
  constructor() { super(); this.quiet = 1e9; }
  process([input]) {
    const samples = input[0] ?? [];
    for (let index = 0; index < samples.length; index++) {
      if (Math.abs(samples[index]) < 0.05) this.quiet++;
      else {
        if (this.quiet > 0.05 * sampleRate) this.port.postMessage(currentTime + index / sampleRate);
        this.quiet = 0;
      }
    }
    if (!samples.length) this.quiet += 128;
    return true;
  }
});`;
const url = URL.createObjectURL(new Blob([code], { type: "text/javascript" }));
const NativeContext = globalThis.AudioContext;
globalThis.AudioContext = class extends NativeContext {
  constructor(options) {
    super(options);
    globalThis.context = this;
    this.audioWorklet.addModule(url).then(() => {
      const node = new AudioWorkletNode(this, "onsets");
      node.port.onmessage = ({ data }) => {
        // The browser's own pair of clocks: which time of the context leaves the loudspeaker when.
        const { contextTime, performanceTime } = this.getOutputTimestamp();
        globalThis.onsets.push(performanceTime + 1000 * (data - contextTime));
      };
      connect.call(node, this.destination);
      taps.set(this, node);
    });
  }
};
AudioNode.prototype.connect = function (target, ...rest) {
  const tap = taps.get(this.context);
  if (tap && target === this.context.destination) connect.call(this, tap);
  return connect.call(this, target, ...rest);
};
"""
"""Records the times of all onsets of sound in ``onsets``, in milliseconds of the page's clock."""

AT = 20
"""The frame in which the clap begins."""
WATCH = """
globalThis.flashes = [];
globalThis.errors = [];
let before = -1;
const isFlash = (frame) => frame >= argument && frame < argument + 3;
const draw = stage.renderer.draw.bind(stage.renderer);
stage.renderer.draw = (picture, ...rest) => {
  const { frame } = picture.order;
  if (isFlash(frame) && !isFlash(before)) flashes.push(performance.now());
  before = frame;
  return draw(picture, ...rest);
};
const step = () => {
  const { sound } = player.stage.playback;
  if (sound.isPlaying) errors.push(1000 * sound.error);
  requestAnimationFrame(step);
};
step();
"""
"""Records when the frame ``argument`` is drawn first, in ``flashes``, and the errors as the player measures them."""
SEEK = """
const seen = flashes.length, heard = onsets.length;
stage.clock.seek(argument);
const until = performance.now() + 20000;
while ((flashes.length === seen || onsets.length === heard) && performance.now() < until) {
  await new Promise((resolve) => setTimeout(resolve, 20));
}
await new Promise((resolve) => setTimeout(resolve, 200));
"""
"""Seeks to the frame ``argument``, and waits for the next clap."""


def open_listening(browser: Any, url: str) -> Iterator[PlayerPage]:
    """Yield a page that records its sound, and close it. Its rules for scripts are off, because they do not allow the
    recorder."""
    context = browser.new_context(viewport={"width": 240, "height": 180}, bypass_csp=True)
    page = context.new_page()
    page.add_init_script(TAP)
    opened = PlayerPage(page, url)
    opened.ready()
    yield opened
    context.close()


def listen(page: PlayerPage) -> None:
    """Start to record the flashes of the frame in which the clap begins."""
    page.run(WATCH, AT)


def seek_before_the_clap(page: PlayerPage, frame: int = 8) -> None:
    """Seek to a frame before the clap while the scene plays, and wait for the clap."""
    page.run(SEEK, frame)


def lags_ms(page: PlayerPage) -> list[float]:
    """The time from each flash to the clap that is nearest, in milliseconds. Negative if the sound is early. A flash
    without a clap within 0.5 s has the lag inf."""
    flashes, claps = page.run("return [flashes, onsets];")
    lags = []
    for flash in flashes:
        nearest = min(claps, key=lambda time: abs(time - flash), default=float("inf"))
        lags.append(nearest - flash if abs(nearest - flash) < 500 else float("inf"))
    return lags
