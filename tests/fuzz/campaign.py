"""Fuzz every reader: `make fuzz`, or `python -m tests.fuzz.campaign --inputs 50000 [--reader NAME] [--seed FIRST]`.

Inputs are read by a process of its own (`worker`). When it dies or hangs, the case is written down and another one goes on behind it.
Ends with a table, and with exit code 1 where anything but success or a refusal came out.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from tests.fuzz.readers import READERS
from tests.fuzz.worker import SECONDS

ROOT = Path(__file__).parents[2]


@dataclass
class Counts:
    """What came out of one reader's inputs. `wrong` has a line for each input that was neither accepted nor refused."""

    accepted: int = 0
    refused: int = 0
    wrong: list[str] = field(default_factory=list)

    @property
    def inputs(self) -> int:
        return self.accepted + self.refused + len(self.wrong)

    def add(self, seed: int, outcome: str) -> None:
        if outcome == "accepted":
            self.accepted += 1
        elif outcome == "refused":
            self.refused += 1
        else:
            self.wrong.append(f"seed {seed}: {outcome.removeprefix('wrong: ')}")


def fuzz(inputs: int, *, first: int = 0, readers: list[int] | None = None, progress: bool = False) -> dict[str, Counts]:
    """Read so many inputs, shared out among the readers, and count what comes out.

    Args:
        first: the first seed of each reader.
        readers: places in `READERS`; None: all.
    """
    chosen = list(range(len(READERS))) if readers is None else readers
    shares = sum(READERS[i].share for i in chosen)
    jobs = [(i, first, max(1, round(inputs * READERS[i].share / shares))) for i in chosen]
    counts = {READERS[i].name: Counts() for i in chosen}
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        while jobs:
            jobs = _by_one_worker(jobs, Path(folder), counts)
            if progress:
                _say(counts, inputs, start)
    return counts


def _by_one_worker(jobs: list[tuple[int, int, int]], folder: Path, counts: dict[str, Counts]) -> list[tuple[int, int, int]]:
    """Have one process do the jobs. Returns those that are left when it has died."""
    at_once = 2000  # then a new process: what a library keeps must not add up to the limit
    now, later, taken = [], [], 0
    for number, first, count in jobs:
        n = min(count, at_once - taken)
        taken += n
        if n:
            now.append((number, first, n))
        if count - n:
            later.append((number, first + n, count - n))
    words = [str(word) for job in now for word in job]
    environment = {**os.environ, "MALLOC_ARENA_MAX": "1", "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    command = [sys.executable, "-m", "tests.fuzz.worker", str(folder), *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, cwd=ROOT) as worker:
        assert worker.stdout is not None
        running, last = _listen(worker, counts)
        code = worker.wait()
    if running is None and code == 0:
        return later
    if running is None and last is None:
        raise RuntimeError(f"a fuzz worker ended with {code} before its first input; call it by hand: {' '.join(command)}")
    number, seed = running or last or (0, 0)
    if running:
        reason = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        hang = f" (more than {SECONDS} s)" if reason == "SIGALRM" else ""
        counts[READERS[number].name].add(seed, f"the process died by {reason}{hang}")
    left = [(n, max(s, seed + 1) if n == number else s, c - (max(s, seed + 1) - s if n == number else 0)) for n, s, c in now]
    done = [n for n, _, _ in now].index(number)
    return [job for job in left[done:] if job[2] > 0] + later


def _listen(worker: subprocess.Popen[str], counts: dict[str, Counts]) -> tuple[tuple[int, int] | None, tuple[int, int] | None]:
    """Count what a worker tells. Returns the case that it was at when it ended, if any, and the last one that it did."""
    assert worker.stdout is not None
    running, last = None, None
    for line in worker.stdout:
        number, seed, outcome = line.rstrip("\n").split(" ", 2)
        case = int(number), int(seed)
        if outcome == "began":
            running = case
        else:
            counts[READERS[case[0]].name].add(case[1], outcome)
            running, last = None, case
    return running, last


def _say(counts: dict[str, Counts], inputs: int, start: float) -> None:
    done, wrong = sum(c.inputs for c in counts.values()), sum(len(c.wrong) for c in counts.values())
    print(f"{done:,} of {inputs:,} inputs, {wrong} wrong, {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)


def table(counts: dict[str, Counts]) -> str:
    """Reader, inputs, accepted, refused, wrong; and each thing that is wrong, once."""
    rows = [(name, c.inputs, c.accepted, c.refused, len(c.wrong)) for name, c in counts.items()]
    rows.append(("all", *(sum(row[k] for row in rows) for k in (1, 2, 3, 4))))  # type: ignore[arg-type, misc]
    head = ("reader", "inputs", "accepted", "refused", "wrong")
    lines = ["| " + " | ".join(head) + " |", "|---|--:|--:|--:|--:|"]
    lines += [f"| {row[0]} | " + " | ".join(f"{number:,}" for number in row[1:]) + " |" for row in rows]
    for name, c in counts.items():
        kinds = Counter(text.split(": ", 1)[1] for text in c.wrong)
        for kind, count in kinds.most_common():
            example = next(text for text in c.wrong if text.endswith(kind))
            lines.append(f"{name}: {count} × {example}")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=50_000)
    parser.add_argument("--seed", type=int, default=0, help="the first seed of each reader")
    parser.add_argument("--reader", choices=[r.name for r in READERS], action="append")
    given = parser.parse_args()
    readers = None if given.reader is None else [i for i, r in enumerate(READERS) if r.name in given.reader]
    counts = fuzz(given.inputs, first=given.seed, readers=readers, progress=True)
    print(table(counts))
    return 1 if any(c.wrong for c in counts.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
