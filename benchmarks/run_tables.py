"""The results of a run as Markdown tables: scale, scores on held-out views, and the time that its stages took.

    python benchmarks/run_tables.py RUN

A synthetic capture has its true scale in `ground_truth.json`. The scale then stands beside the truth.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from rtgs.evaluation.records import Evaluation
from rtgs.metrics.scores import SCORES
from rtgs.run.folder import RunFolder
from rtgs.run.stages import TITLES
from rtgs.run.summary import MODEL_TITLES


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(cells) + " |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|---|" + "---:|" * (len(head) - 1), *lines[1:]])


def scale_table(folder: RunFolder) -> str:
    scale = folder.read_scale()
    rows = [["found", f"{scale.sfm_per_metre:.5g}"]]
    if scale.ci95 is not None:
        rows.append(["95 % interval", f"{scale.ci95[0]:.5g} to {scale.ci95[1]:.5g}"])
    rows.append(["verdict", scale.status])
    truth_json = folder.read_config().capture / "ground_truth.json"
    if truth_json.is_file():
        truth = json.loads(truth_json.read_text(encoding="utf-8"))["sfm_per_metre"]
        rows += [["truth", f"{truth:.5g}"], ["error", f"{100 * abs(scale.sfm_per_metre / truth - 1):.3f} %"]]
    return table(["SfM units per metre", ""], rows)


def score_table(evaluation: Evaluation) -> str:
    known = {key: scores.known() for key, scores in evaluation.models.items()}
    columns = [name for name in SCORES if any(name in scores for scores in known.values())]
    rows = [
        [MODEL_TITLES[key], *(SCORES[c].number(scores[c]) if c in scores else "" for c in columns)]
        for key, scores in known.items()
    ]
    return table(["held-out views", *(SCORES[c].heading for c in columns)], rows)


def time_table(evaluation: Evaluation) -> str:
    rows = [[TITLES.get(key, key), f"{seconds:.0f}"] for key, seconds in evaluation.timings_s.items()]
    return table(["seconds", ""], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    folder = RunFolder(parser.parse_args().run)
    evaluation = Evaluation.read(folder.path / "metrics.json")
    print("\n\n".join([scale_table(folder), score_table(evaluation), time_table(evaluation)]))


if __name__ == "__main__":
    main()
