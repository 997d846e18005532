"""The command line: `rtgs COMMAND`. No algorithm lives here, and a command imports what it runs: help should not wait for torch.

Exit codes: 0 done, 1 a defect of the program, 2 input that cannot be used (one message on stderr), 3 a capture with warnings
(`rtgs doctor`), 130 stopped with Ctrl-C,
143 stopped with SIGTERM, 141 whoever read the output has ended.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence

import tyro
from rich.console import Console

from rtgs import __version__
from rtgs.base.errors import RtgsError
from rtgs.base.events import Listener, to_all
from rtgs.base.files import reason
from rtgs.cli.manners import Manners, taken_out
from rtgs.cli.options import saved_settings
from rtgs.cli.overview import text_of
from rtgs.cli.signals import Terminated, sigterm_as_ctrl_c, stop_behind
from rtgs.cli.table import FROM_RUN, all_commands, calibrate_commands, experiment_commands
from rtgs.cli.terminal import Terminal
from rtgs.config.ranges import SettingError

_ABOUT = "From synchronised RGB and thermal photographs to one metric 3D Gaussian model that renders both."
_ABOUT_CALIBRATE = "A rig from pictures of a board, or from a run that found it."
_GO_ON = ("run", "sfm", "rgb", "scale", "thermal", "eval", "demo", "experiment")  # the others begin anew
_ABOUT_EXPERIMENT = "The tables: this method and its rivals, on scenes whose truth is known and on captures."


def main(arguments: Sequence[str] | None = None, listener: Listener | None = None) -> None:
    """Entry point of the `rtgs` command.

    Args:
        arguments: without the program's name; None: those of this process.
        listener: gets the events of the work; None: the terminal shows them.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    try:
        try:
            _command(arguments, listener)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # whoever read the output has ended, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what Python still has to write
        sys.exit(128 + 13)


def _command(arguments: Sequence[str], listener: Listener | None) -> None:
    """Do what the command line asks for, and say in one line why it cannot be done."""
    manners, arguments = taken_out(arguments)
    if arguments[:1] == ["--version"]:
        print(f"rtgs {__version__}")
        if arguments[1:] in (["-v"], ["--verbose"]):
            from rtgs.base.machine import facts

            print("\n".join(f"{name}: {value}" for name, value in facts().items()))
        return
    try:
        with sigterm_as_ctrl_c() as stopper:
            _run(arguments, to_all(listener or Terminal(manners), stopper), manners)
    except (Exception, KeyboardInterrupt) as error:
        if (stop := stop_behind(error)) is not None:
            goes_on = arguments[:1] in ([name] for name in _GO_ON)
            Console(stderr=True).print("stopped; the same command goes on from here" if goes_on else "stopped")
            sys.exit(143 if isinstance(stop, Terminated) else 130)
        if isinstance(error, BrokenPipeError):
            raise
        if manners.debug:
            traceback.print_exception(error)
        if isinstance(error, SettingError):
            _complain(f"{_flag(error.name, arguments)} {error.text}")
        elif isinstance(error, RtgsError):
            _complain(str(error))
        elif isinstance(error, UnicodeEncodeError):
            name = error.object[max(error.start - 60, 0) : error.end + 60]
            _complain(f"{name!r}: holds a name that is not UTF-8. Rename the file or folder.")
        elif isinstance(error, RuntimeError) and "Symlink loop" in str(error):  # as pathlib says it before Python 3.13
            _complain(f"{error}. Remove the link, or name what it was meant to lead to.")
        elif isinstance(error, OSError):  # a full disk, a folder that may not be written
            _complain(f"{error.filename}: {reason(error)}" if error.filename else str(error))
        elif listener is not None:  # whoever calls this from a program wants the exception itself
            raise
        else:
            _complain(
                f"a defect of rtgs: {type(error).__name__}: {error}. Report it with what --debug and `rtgs --version -v` print."
            )
            sys.exit(1)
        sys.exit(2)


def _run(arguments: Sequence[str], listener: Listener, manners: Manners) -> None:
    table, prog, about = all_commands(saved_settings(arguments), listener, as_json=manners.json), "rtgs", _ABOUT
    if not arguments or arguments[0] in ("-h", "--help"):
        print(text_of(about, table))
        return
    if arguments[:1] == ["experiment"]:
        table, prog, about, arguments = experiment_commands(listener), "rtgs experiment", _ABOUT_EXPERIMENT, arguments[1:]
    if arguments[:1] == ["calibrate"]:
        table, prog, about, arguments = calibrate_commands(listener), "rtgs calibrate", _ABOUT_CALIBRATE, arguments[1:]
        if arguments and arguments[0] not in (*table, "-h", "--help"):
            arguments = [FROM_RUN, *arguments]
    tyro.extras.subcommand_cli_from_dict(table, prog=prog, description=about, args=arguments or ["--help"])


def _flag(setting: str, arguments: Sequence[str]) -> str:
    """The flag of a setting where it was typed, with or without the names of its groups; else the setting's name."""
    typed = {argument.split("=")[0].replace("_", "-") for argument in arguments}
    parts = setting.replace("_", "-").split(".")
    flags = ("--" + ".".join(parts[k:]) for k in range(len(parts)))
    return next((flag for flag in flags if flag in typed), setting)


def _complain(text: str) -> None:
    text = text.encode("utf-8", "backslashreplace").decode()  # a path may hold bytes that are no text
    console = Console(stderr=True)
    console.print("error:", style="bold red", end=" ")
    console.print(text, markup=False, emoji=False, highlight=False, soft_wrap=True)  # a path may hold [brackets]
