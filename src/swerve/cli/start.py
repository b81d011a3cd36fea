"""Start the `swerve` command: Ctrl-C ends it with status 130 at any moment, imports included.

Importing this module takes SIGINT: only the command may. A process that was started to ignore it
goes on ignoring it.
"""

from __future__ import annotations

import atexit
import signal
import sys

from swerve.base.interrupts import leave, listen, take

take(leave)  # nothing has begun
# registered first, so called last: Python lets SIGINT kill it while it ends, when all is done
atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)


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
        take(leave)  # everything is done
