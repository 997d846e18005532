"""What a run tells its listener."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.helpers.recorder import Recorder
from tests.helpers.tiny_run import recorded

from rtgs.base.events import Event, ModelSnapshot, ResultLine, WorkFinished, WorkProgress, WorkStarted
from rtgs.run.folder import RunFolder
from rtgs.run.stages import STAGES, TITLES


def events_of(recorder: Recorder, name: str) -> list[Event]:
    return [e for e in recorder.events if getattr(e, "name", None) == name]


def test_each_piece_of_work_starts_goes_on_and_ends_before_the_next(recording: tuple[Path, Recorder]) -> None:
    _, recorder = recording
    bounds = [e for e in recorder.events if isinstance(e, WorkStarted | WorkFinished)]
    assert [type(e) for e in bounds] == [WorkStarted, WorkFinished] * len(TITLES)
    assert [e.name for e in bounds] == [name for name in TITLES for _ in range(2)]
    for name, title in TITLES.items():
        own = events_of(recorder, name)
        assert own[0] == WorkStarted(name, title)
        assert isinstance(own[-1], WorkFinished) and own[-1].completed and own[-1].seconds > 0
        steps = [e for e in own if isinstance(e, WorkProgress)]
        assert steps and all(0 <= e.done <= e.total for e in steps), name
        first, last = recorder.events.index(own[0]), recorder.events.index(own[-1])
        assert [e for e in recorder.events[first : last + 1] if not isinstance(e, ResultLine)] == own


def test_each_stage_says_a_result(recording: tuple[Path, Recorder]) -> None:
    run, recorder = recording
    for stage in STAGES[:-1]:
        assert any(line.startswith(f"{stage.name}: ") for line in recorder.lines), stage.name
    assert any(line.startswith("held-out thermal: PSNR") for line in recorder.lines)
    assert recorder.events[-1] == ResultLine(f"report: {run / 'report.html'}")


def test_the_rgb_model_is_shown_as_it_grows(recording: tuple[Path, Recorder]) -> None:
    run, recorder = recording
    shots = [e for e in recorder.events if isinstance(e, ModelSnapshot)]
    assert [s.step for s in shots] == list(range(2, 41, 2))
    assert len(shots[0].model.gaussians) == 250 < len(shots[-1].model.gaussians)
    last, stored = shots[-1].model.gaussians.tensors(), RunFolder(run).read_rgb().gaussians.tensors()
    for name, tensor in stored.items():
        np.testing.assert_allclose(last[name].numpy(), tensor.numpy(), rtol=1e-6, atol=5e-6, err_msg=name)
    same_size = [s.model.gaussians.means for s in shots if len(s.model.gaussians) == 250]
    assert all(not np.array_equal(a.numpy(), b.numpy()) for a, b in pairwise(same_size))  # copies


@pytest.mark.parametrize(("name", "at"), [("rgb", 3), ("scale", 2)])
def test_work_that_is_cut_off_ends_too(capture: Path, run: Path, name: str, at: int) -> None:
    arguments = ["rgb", str(run), "--steps", "39"] if name == "rgb" else ["scale", str(run), "--steps", "6"]
    recorder, code = recorded(arguments, stop_in=name, stop_at=at)
    assert code == 130
    end = events_of(recorder, name)[-1]
    assert isinstance(end, WorkFinished) and not end.completed
