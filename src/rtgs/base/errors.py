"""The one exception a user is meant to read."""

from __future__ import annotations


class RtgsError(Exception):
    """Wrong input or an impossible request, said in one message.

    The message names the file, the field and the remedy. The command line prints it without a traceback and exits with
    status 2.
    """
