"""Start the `swerve` command: Ctrl-C ends it with status 130 at any moment, imports included.

Importing this module takes SIGINT: only the command may.
"""

from __future__ import annotations

import signal
import sys

from swerve.base.interrupts import leave, listen

signal.signal(signal.SIGINT, leave)  # nothing has begun


def main() -> None:
    """Run the command."""
    from swerve.cli.app import main as run

    try:
        listen()
        run()
    except KeyboardInterrupt:  # outside of what `run` catches
        leave()
    finally:
        if sys.stdout is not None:
            sys.stdout.flush()
        signal.signal(signal.SIGINT, leave)  # everything is done
