"""Fill a page of docs/results with what its command prints.

    python docs/make_results.py                              list the pages and their commands
    python docs/make_results.py demo --out DIR               run the command, and replace the page's header and table
    python docs/make_results.py scale-halves --run RUN       for pages that start from a run, or from a capture (--capture DIR)

A page keeps its explanations. Between `<!-- measured -->` and `<!-- end -->` stands only what this script wrote: command, version,
machine, date, and the tables of the command's output. Commands take minutes to hours.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from rtgs.experiments.provenance import HEADING, Provenance

ROOT = Path(__file__).parents[1]
SCENES = ("chair", "drums", "hotdog", "lego", "materials", "ship", "room")
BEGIN, END = "<!-- measured -->", "<!-- end -->"


@dataclass(frozen=True)
class Page:
    """A page and what fills it.

    Attributes:
        command: with {out}, {run} and {capture} for folders, {scene} for one of `scenes`; `rtgs …` or `python …`.
        file: where under {out} the command leaves its Markdown; None: it prints it.
        scenes: the command is run for each of these, and their tables stand below each other.
        then: a second command that prints the tables, where the first prints none.
    """

    name: str
    command: str
    file: str | None = None
    scenes: tuple[str, ...] = ("",)
    then: str = ""


PAGES = {
    page.name: page
    for page in (
        Page("scale-synthetic", "rtgs experiment synthetic --out {out} --rgb.quality default", "table_1.md"),
        Page("scale-perturbed", "rtgs experiment synthetic --out {out} --table 2 --seeds 2 --rgb.quality default", "table_2.md"),
        Page(
            "scale-ablation",
            "rtgs experiment synthetic --out {out} --table ablation --seeds 1 --scenes chair drums hotdog",
            "table_ablation.md",
        ),
        Page("refinement", 'python benchmarks/refine_scale.py --out {out} --seeds 5 --rows "focal 2,direction"'),
        Page(
            "uncalibrated",
            "python benchmarks/uncalibrated.py --out {out} --scenes room,lego,materials,chair --run {run} --focal 726.5,764.7,802.9",
        ),
        Page("interval-coverage", "python benchmarks/scale_coverage.py --out {out}"),
        Page("scale-verdict", "python benchmarks/scale_verdict.py --out {out}"),
        Page("imported-model", "python benchmarks/imported_model.py --out {out}"),
        Page("scale-halves", "python benchmarks/scale_splits.py {run}"),
        Page("world-frame", "python benchmarks/world_frame.py --out {out} --captures {capture} --every 3"),
        Page("scale-speed", "python benchmarks/scale_speed.py {run}"),
        Page(
            "table3-room",
            "rtgs experiment real {run} --out {out} --manual.frames frame_001 frame_013 --manual.metres 1.16254",
            "table3.md",
        ),
        Page("table3-arco", "rtgs experiment real {run} --out {out} --thermal.drift offset", "table3.md"),
        Page("arco", "rtgs run {capture} --out {out}", then="python benchmarks/run_tables.py {out}"),
        Page("demo", "rtgs demo --out {out}", then="python benchmarks/run_tables.py {out}/run"),
        Page("thermal-adam", "python benchmarks/thermal.py --scene {scene} --out {out}/{scene}", scenes=SCENES),
        Page("thermal-truth", "python benchmarks/thermal.py --scene {scene} --out {out}/{scene} --steps ''", scenes=SCENES),
        Page("thermal-rules", "python benchmarks/thermal_rules.py --out {out} --run {run}"),
        Page("hot-spots", "python benchmarks/hot_spots.py --out {out}"),
        Page("renderer-speed", "python benchmarks/render.py"),
        Page("renderer-rivals", "python benchmarks/render.py --only rival"),
        Page(
            "training",
            "python benchmarks/train.py {capture} --out {out} --threads 2 --seeds 0 1 --times-four --scale",
            "train.md",
        ),
        Page("ssim", "python benchmarks/ssim.py"),
    )
}


def tables(text: str) -> str:
    """The Markdown tables in a command's output, one blank line between them, without the command's own provenance."""
    blocks = re.findall(r"(?:^\|.*\n?)+", text + "\n", flags=re.MULTILINE)
    return "\n\n".join(block.strip() for block in blocks if not block.startswith(f"| {HEADING} |"))


def called(command: str) -> str:
    """What a command prints. It runs in the repository's folder."""
    words = shlex.split(command)
    program = [sys.executable, "-m", "rtgs"] if words[0] == "rtgs" else [sys.executable]
    environment = os.environ | {"PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run([*program, *words[1:]], cwd=ROOT, env=environment, check=True, text=True, stdout=subprocess.PIPE)
    return done.stdout


def fill(page: str, content: str) -> str:
    """The page with what stands between its two marks replaced.

    Raises:
        ValueError: the page has no marks.
    """
    before, mark, rest = page.partition(BEGIN)
    _, closing, after = rest.partition(END)
    if not mark or not closing:
        raise ValueError(f"the page has no {BEGIN} … {END}")
    return f"{before}{BEGIN}\n\n{content.strip()}\n\n{END}{after}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", nargs="?", choices=sorted(PAGES))
    for folder in ("out", "run", "capture"):
        parser.add_argument(f"--{folder}", type=Path, default=None)
    o = parser.parse_args()
    if o.page is None:
        print("\n".join(f"{page.name:20} {page.command}" for page in PAGES.values()))
        return
    page = PAGES[o.page]
    needed = {name: getattr(o, name) for name in ("out", "run", "capture") if f"{{{name}}}" in page.command}
    if missing := [name for name, value in needed.items() if value is None]:
        parser.error(f"{page.name} needs --{' --'.join(missing)}")
    found = []
    for scene in page.scenes:
        folders = {name: shlex.quote(str(value)) for name, value in needed.items()}
        printed = [called(command.format(scene=scene, **folders)) for command in (page.command, page.then) if command]
        table = tables((o.out / page.file).read_text(encoding="utf-8") if page.file else printed[-1])
        if not table:
            sys.exit(f"{page.name}: the command printed no table")
        found.append(f"**{scene}**\n\n{table}" if scene else table)
    shown = page.command.format(out="DIR", run="RUN", capture="CAPTURE", scene="SCENE")
    path = ROOT / "docs" / "results" / f"{page.name}.md"
    measured = "\n\n".join(found)
    if not measured.startswith(f"| {HEADING}"):  # `rtgs experiment` says it itself
        measured = f"{Provenance.of(shown).markdown()}\n\n{measured}"
    path.write_text(fill(path.read_text(encoding="utf-8"), measured), encoding="utf-8")
    print(f"filled {path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
