"""Whether a scale can be believed: "ok", "ambiguous" or "unobservable", and why in words."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rtgs.scale.bracket import Bracket
from rtgs.scale.interval import MODEL_PIXELS, WIDEST, Interval
from rtgs.scale.problem import Found
from rtgs.scale.records import Status

_APART = 1 / 3  # of the frames, from which on their disagreement is the rule (chosen by `benchmarks/scale_verdict.py`)
_LIKELY = 0.025  # share of the frames' resamples from which on another minimum is not ruled out


@dataclass(frozen=True)
class Verdict:
    """As `ScaleEstimate.status` and `ScaleEstimate.reason`; the reason is empty where the status is "ok"."""

    status: Status
    reason: str


def verdict_of(found: Found, interval: Interval, *, refined_later: bool = False) -> Verdict:
    """Weigh what a solver found and how sure it is. The first of these that holds decides:

    1. the solver has a doubt of its own: the answer lies at or beyond an end of the bracket, or fits no better than no baseline;
    2. the curves are flat: the resampled minima do not lie inside of them;
    3. half the 95 % interval is wider than 0.5 in ln s;
    4. more than a third of the frames place their minimum elsewhere;
    5. another minimum is the better one in more than 2.5 % of the frames' resamples: "ambiguous".

    Args:
        refined_later: the calibration is refined next, which may bring the frames to agree; `refine` asks them then.
    """
    if found.doubt:
        return Verdict("unobservable", found.doubt)
    if interval.std_log is not None and not found.closed:
        ends = found.curves.thetas
        return Verdict(
            "unobservable",
            f"the loss is flat: between {math.exp(ends[0]):.4g} and {math.exp(ends[-1]):.4g} SfM units per metre, no scale stands "
            "out in all resamples of the frames.",
        )
    if interval.half_width > WIDEST:
        return Verdict("unobservable", _left_open(interval))
    discord = "" if refined_later else discord_of(len(found.disagreeing), len(found.curves.frames))
    if discord:
        return Verdict("unobservable", discord)
    likely = [m for m in found.minima if m.chance > _LIKELY]
    if likely:
        others = " and ".join(f"{m.sfm_per_metre:.4g}" for m in likely)
        return Verdict(
            "ambiguous",
            f"the edges meet as well at {others} SfM units per metre; frames with nearer things would tell which is right.",
        )
    return Verdict("ok", "")


def discord_of(apart: int, frames: int) -> str:
    """Why so many frames that disagree leave the scale open; empty where they are a third of all or fewer."""
    if apart <= _APART * frames:
        return ""
    return (
        f"{apart} of {frames} frames place the scale elsewhere, so that they do not agree on one. Look for wrong pairs, and for an RGB "
        "model without the edges of the scene (its held-out PSNR and pictures); more frames and more training help."
    )


def _left_open(interval: Interval) -> str:
    text = f"the frames leave the scale open by a factor of {math.exp(min(interval.half_width, 10.0)):.2g} to either side."
    if interval.misfit.px <= MODEL_PIXELS:
        return text
    return (
        f"{text} The edges miss each other by {interval.misfit.px:.2g} px however the scale is chosen: if the rotation in rig.json may be "
        "wrong, add --scale.refine rotation; else train the RGB model longer."
    )


def at_an_end(side: str, bracket: Bracket) -> str:
    """Why the images do not decide where a scan is lowest at an end; `side`: "below" or "above"."""
    return f"the loss is lowest at an end of the scan: the scale lies {side} {_observable_range(bracket)}"


def outside(theta: float, bracket: Bracket) -> str:
    """Why the images do not decide where the answer lies outside of the bracket; empty where it lies inside."""
    s = math.exp(theta)
    if bracket.lower <= s <= bracket.upper:
        return ""
    return f"the scale found, {s:.4g}, lies {'below' if s < bracket.lower else 'above'} {_observable_range(bracket)}"


def no_better_than_none(theta: float, bracket: Bracket) -> str:
    """Why the images do not decide where they fit no baseline as well as the answer."""
    return (
        f"the images fit no baseline at all as well as {math.exp(theta):.4g}: if there is a scale, it may lie below "
        f"{_observable_range(bracket)}"
    )


def _observable_range(bracket: Bracket) -> str:
    return f"what the images can tell ({bracket}), or the edges of the two modalities do not agree."
