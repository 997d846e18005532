"""A directive that shows a command's help as the installed program prints it, so that the page cannot go out of date.

```{cli-help} run
```
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

SOURCE = Path(__file__).parents[2] / "src"
COLUMNS = 96
_ANSI = re.compile(r"\x1b\[[0-9;]*m")


def help_of(command: str) -> str:
    """What `rtgs COMMAND --help` prints, without colours.

    Raises:
        RuntimeError: the program does not know the command.
    """
    environment = os.environ | {"PYTHONPATH": str(SOURCE), "COLUMNS": str(COLUMNS), "NO_COLOR": "1", "TERM": "dumb"}
    environment.pop("FORCE_COLOR", None)
    arguments = [sys.executable, "-m", "rtgs", *command.split(), "--help"]
    done = subprocess.run(arguments, capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        raise RuntimeError(f"`rtgs {command} --help` fails: {done.stderr.strip()[-300:]}")
    return "\n".join(line.rstrip() for line in _ANSI.sub("", done.stdout).strip().splitlines())


class CliHelp(SphinxDirective):
    """`{cli-help} COMMAND`: the help of one command, "" for the program's own."""

    optional_arguments: ClassVar[int] = 1
    final_argument_whitespace: ClassVar[bool] = True

    def run(self) -> list[nodes.Node]:
        text = help_of(self.arguments[0] if self.arguments else "")
        return [nodes.literal_block(text, text, language="text", classes=["cli-help"])]


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("cli-help", CliHelp)
    return {"parallel_read_safe": True}
