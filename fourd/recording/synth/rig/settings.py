"""The strength of each factor by which a real recording differs from a clean one, and the text that selects factors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from fourd.base.errors import UserError

Codec = Literal["h264", "hevc"]


@dataclass(frozen=True)
class RigSettings:
    """Strengths of all factors. A factor of strength 0 is off.

    Attributes:
        exposure: standard deviation of the logarithm of a camera's gain, 0 to 1.
        white_balance: standard deviation of the logarithm of a camera's gain in each channel, 0 to 1.
        vignetting: mean share of the light that is missing in the corners of the image, 0 to 0.75.
        noise: standard deviation of the noise in grey levels at the grey level 126, 0 to 50.
        blur: mean standard deviation of the lens blur in pixels, 0 to 20.
        motion_blur: time that the shutter is open, as a fraction of the time between two frames, 0 to 1.
        rolling_shutter: time from the exposure of the first row to that of the last row, as a fraction of the time
            between two frames, 0 to 1.
        offset: largest time offset of a camera in frames, 0 to 0.5.
        calibration: errors of the calibration as a multiple of the usual errors, 0 to 100; see
            :mod:`fourd.recording.synth.rig.calibration`.
        people: number of people who walk in the background, 0 to 9.
        video: constant rate factor of the compressed videos, 1 (best) to 51, or 0 for PNG images instead of videos.
        codec: format of the videos.
        mbps: bit rate of each video in Mbit/s, or None if ``video`` determines the rate.
        seed: seed of all random numbers, at least 0.

    Raises:
        UserError: if a value is out of range.
    """

    exposure: float = 0.0
    white_balance: float = 0.0
    vignetting: float = 0.0
    noise: float = 0.0
    blur: float = 0.0
    motion_blur: float = 0.0
    rolling_shutter: float = 0.0
    offset: float = 0.0
    calibration: float = 0.0
    people: float = 0.0
    video: float = 0.0
    codec: Codec = "h264"
    mbps: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        for name, maximum in _MAXIMA.items():
            value = getattr(self, _field(name))
            if not 0 <= value <= maximum:
                raise UserError(
                    f"--rig: {name}: expected 0 to {maximum:g}, got {value:g}; write for example "
                    f"{name}={getattr(USUAL, _field(name)):g}"
                )
        for name in ("people", "video"):
            value = getattr(self, name)
            if value != int(value):
                raise UserError(f"--rig: {name}: expected a whole number, got {value:g}; write {name}={round(value)}")
        if self.mbps is not None and not self.video:
            raise UserError("--mbps: expected the factor video, got --rig without it; add video to --rig")
        if self.mbps is not None and not 0.01 <= self.mbps <= 1000:
            raise UserError(f"--mbps: expected 0.01 to 1000 Mbit/s, got {self.mbps:g}; write for example --mbps 8")
        if not 0 <= self.seed < 2**63:
            raise UserError(f"--seed: expected 0 to {2**63 - 1}, got {self.seed}; give a number in that range")


_MAXIMA = {
    "exposure": 1.0,
    "white-balance": 1.0,
    "vignetting": 0.75,
    "noise": 50.0,
    "blur": 20.0,
    "motion-blur": 1.0,
    "rolling-shutter": 1.0,
    "offset": 0.5,
    "calibration": 100.0,
    "people": 9.0,
    "video": 51.0,
}
FACTORS = tuple(_MAXIMA)
"""Names of all factors."""


def _field(factor: str) -> str:
    return factor.replace("-", "_")


USUAL = RigSettings(
    exposure=0.08,
    white_balance=0.04,
    vignetting=0.2,
    noise=2.5,
    blur=0.6,
    motion_blur=0.2,
    rolling_shutter=0.3,
    offset=0.25,
    calibration=1.0,
    people=3,
    video=23,
)
"""Strengths of the factors in a rig of good consumer cameras: the defaults of the factors that are selected by name."""


def parse_factors(
    words: Sequence[str], *, codec: Codec = "h264", mbps: float | None = None, seed: int = 0
) -> RigSettings:
    """Parse the value of the option --rig: names of factors, or NAME=VALUE with the strength of a factor, separated by
    commas. No name, or the name ``all``, selects all factors.

    Raises:
        UserError: if a name is unknown, a factor is named twice, or a strength is not valid.
    """
    given: dict[str, float] = {}
    entries = [entry.strip() for word in words for entry in word.split(",")] or ["all"]
    for entry in entries:
        name, has_value, text = entry.partition("=")
        if name == "all" and not has_value:
            continue
        if name not in FACTORS:
            raise UserError(f"--rig: expected factors among all, {', '.join(FACTORS)}, got '{name}'; correct the name")
        if _field(name) in given:
            raise UserError(f"--rig: {name}: expected each factor once, got it twice; leave out one of them")
        given[_field(name)] = _number(name, text) if has_value else float(getattr(USUAL, _field(name)))
    base = USUAL if "all" in entries else RigSettings()
    return replace(base, **given, codec=codec, mbps=mbps, seed=seed)


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        usual = getattr(USUAL, _field(name))
        raise UserError(f"--rig: {name}: expected a number, got '{text}'; write for example {name}={usual:g}") from None
