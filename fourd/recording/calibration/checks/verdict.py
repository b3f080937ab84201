"""The verdict of ``fourd check`` in words: what the matches verify, what they do not, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fourd.recording.calibration.checks.agreement import Agreement, is_disagreeing
from fourd.recording.calibration.checks.evidence import CameraEvidence

MOST_NAMES = 8


@dataclass(frozen=True)
class Verdict:
    """The last line of a check.

    Attributes:
        words: the verdict, without a full stop.
        is_good: whether everything was checked and is right.
    """

    words: str
    is_good: bool


def judge(agreement: Agreement | None, warnings: Sequence[str], *, is_subject_agreeing: bool = False) -> Verdict:
    """Return the verdict on a capture that has no problems.

    Args:
        agreement: result of the check of the calibration, or None if the images were not matched.
        warnings: all warnings about the capture.
        is_subject_agreeing: whether the mattes verify the calibration, so that it needs no matches.
    """
    if agreement is None:
        return Verdict("Complete, but neither the calibration nor the images were checked (--quick)", False)
    if agreement.suspicious:
        names = ", ".join(agreement.suspicious)
        return Verdict(f"Usable, but the calibration looks wrong for: {names} (see the warnings above)", False)
    if agreement.score is not None and agreement.pairs > 1 and is_disagreeing(agreement.score):
        return Verdict("Usable, but the calibration does not fit the images (see the warnings above)", False)
    unverified = agreement.unverified
    if is_subject_agreeing:
        seen = "the mattes verify the calibration, for which the images have too few matches"
        return Verdict(
            f"Usable, but see the warnings above; {seen}" if warnings else f"Good to use; {seen}", not warnings
        )
    if len(unverified) == len(agreement.evidence):
        return Verdict(
            "Usable, but the calibration could not be verified: the images have too few matches, which is common for "
            "distant cameras and plain surfaces",
            False,
        )
    if unverified:
        names = _names(unverified)
        return Verdict(f"Usable, but the calibration could not be verified for: {names}", False)
    if warnings:
        return Verdict("Usable, but see the warnings above", False)
    return Verdict("Good to use", True)


def describe_residuals(agreement: Agreement) -> str:
    """Return the residuals of all matches, and of the worst camera."""
    if agreement.score is None:
        return f"unknown: only {agreement.matches} points match between the cameras, which are too few"
    # If most cameras are not verified, the worst of the others says nothing about the calibration.
    worst = agreement.worst if 2 * len(agreement.unverified) < len(agreement.evidence) else None
    shown = f"; worst verified camera: {worst}" if worst else ""
    return f"{agreement.score} of their epipolar lines, over {agreement.pairs} camera pairs{shown}"


def describe_verified(agreement: Agreement) -> str:
    """Return how many cameras the matches verify, and the evidence for the other cameras."""
    unverified = agreement.unverified
    total = len(agreement.evidence)
    text = f"verified for {total - len(unverified)} of {total} cameras"
    if not any(each.matches for each in unverified):
        return text + (f"; no matches: {_names(unverified)}" if 0 < len(unverified) < total else "")
    return f"{text}; not verified: {', '.join(map(str, unverified[:MOST_NAMES]))}{_more(unverified)}"


def _names(cameras: Sequence[CameraEvidence]) -> str:
    return ", ".join(each.name for each in cameras[:MOST_NAMES]) + _more(cameras)


def _more(cameras: Sequence[CameraEvidence]) -> str:
    return f" and {len(cameras) - MOST_NAMES} more" if len(cameras) > MOST_NAMES else ""
