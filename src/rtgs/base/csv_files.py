"""CSV files, written whole or not at all."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

from rtgs.base.files import write_text_whole


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> Path:
    """Write a header and rows as UTF-8, and return the path."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_text_whole(path, text.getvalue())
    return path


def write_records_csv(path: Path, kind: type, records: Iterable[Any]) -> Path:
    """Write instances of one dataclass, a column a field, and return the path."""
    return write_csv(path, [f.name for f in fields(kind)], map(astuple, records))
