"""Kill runs at random moments and let them go on."""

from __future__ import annotations

import random
import shutil
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from tests.faults.processes import EXIT_CODES, left_behind, results, rtgs, stopped

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
_DUMPS = ("Traceback", "stack trace", "***", "Aborted")


@dataclass(frozen=True)
class Kill:
    """One signal: when it was sent, how the process ended, and what was wrong ("" where nothing was)."""

    number: signal.Signals
    after_s: float
    code: int
    wrong: str


def kill_and_resume(
    arguments: list[str], run: Path, whole: dict[str, str], moments: list[tuple[signal.Signals, float]]
) -> list[Kill]:
    """Kill `rtgs run` at these moments, one after the other until it has ended by itself, then let it end.

    Args:
        arguments: of the run; run: its folder.
        whole: `results` of a run that was not killed.
    """
    kills: list[Kill] = []
    for number, after_s in moments:
        code, errors = stopped(arguments, number, after_s)
        wrong = [] if code in (EXIT_CODES[number], 0) else [f"exit code {code}: {errors[-4000:]}"]
        wrong += [f"stderr says {word}" for word in _DUMPS if word in errors]
        wrong += [f"process {p} is left" for p in left_behind(run)]
        kills.append(Kill(number, after_s, code, "; ".join(wrong)))
        if code == 0:
            break
    with rtgs(arguments) as process:
        errors = process.communicate(timeout=600)[1]
    now = results(run) if run.exists() else {}
    differing = [f"{name} differs" for name in sorted({*now, *whole}) if now.get(name) != whole.get(name)]
    if process.returncode != 0:
        differing = [f"resumed with exit code {process.returncode}: {errors[-4000:]}"]
    if differing:
        kills[-1] = replace(kills[-1], wrong="; ".join([kills[-1].wrong, *differing]))
    return kills


def campaign(
    arguments_for: Callable[[Path], list[str]], folder: Path, kills: int, *, seed: int = 0, a_run: int = 5
) -> list[Kill]:
    """So many kills at random moments of runs at work, up to `a_run` on each. Those that came too late are not counted.

    Args:
        arguments_for: of a run in a given folder.
    """
    rng = random.Random(seed)
    # A process that compiles kernels is slower and rounds differently from those that load them: the first run is for the cache.
    for name in ("compiled", "whole"):
        start = time.monotonic()
        with rtgs(arguments_for(folder / name)) as process:
            errors = process.communicate(timeout=600)[1]
        assert process.returncode == 0, errors
        seconds = time.monotonic() - start
    whole, done, hit = results(folder / "whole"), list[Kill](), 0
    while hit < kills:
        run = folder / f"run-{len(done)}"
        n = min(a_run, kills - hit)
        moments = [(SIGNALS[(hit + k) % 3], rng.uniform(0.3, 0.7 * seconds)) for k in range(n)]
        done += kill_and_resume(arguments_for(run), run, whole, moments)
        hit = sum(kill.code != 0 for kill in done)
        shutil.rmtree(run, ignore_errors=True)
        print(f"{hit} kills, {sum(bool(k.wrong) for k in done)} wrong", flush=True)
    return done


def table(kills: list[Kill]) -> str:
    """A row a signal, and each kill that had something wrong."""
    lines = ["| signal | kills | at work, and exit code | ended before | wrong |", "|---|--:|--:|--:|--:|"]
    for number in SIGNALS:
        some = [k for k in kills if k.number == number]
        hit, ended = (sum(k.code == code for k in some) for code in (EXIT_CODES[number], 0))
        wrong = sum(bool(k.wrong) for k in some)
        lines.append(f"| {number.name} | {len(some)} | {hit} × {EXIT_CODES[number]} | {ended} | {wrong} |")
    return "\n".join([*lines, *(f"{k.number.name} after {k.after_s:.2f} s: {k.wrong}" for k in kills if k.wrong)])
