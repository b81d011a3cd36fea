"""Run the `swerve` command: register the commands, turn errors into one line.

A command imports heavy packages inside its function, so that `swerve infer` on a work folder that
holds the answer starts at once.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import NoReturn

import cyclopts
from cyclopts import CycloptsError, Parameter

from swerve.base.interrupts import STATUS, heeded, is_asked
from swerve.base.version import VERSION
from swerve.cli.demo import demo
from swerve.cli.demonstrate import demonstrate
from swerve.cli.fit_beta import fit_beta
from swerve.cli.infer import infer
from swerve.cli.learn import learn, sample
from swerve.cli.options import say
from swerve.cli.reproduce import reproduce
from swerve.cli.values import convert
from swerve.cli.watch import watch

app = cyclopts.App(
    name="swerve",
    help="Infer which constraint a demonstrator is obeying.",
    version=VERSION,
    default_parameter=Parameter(negative=(), converter=convert),
    suppress_keyboard_interrupt=False,
)
for command in (infer, fit_beta, watch, learn, sample, demo, demonstrate, reproduce):
    app.command(command)


def main() -> None:
    """Run the command; errors become one line and an exit status."""
    try:
        with heeded():
            app(sys.argv[1:], exit_on_error=False, print_error=False)
    except CycloptsError as error:
        say(f"swerve: error: {str(error).removesuffix('.')}; see --help")
        sys.exit(2)
    except BrokenPipeError:  # the reader of the output, such as head, has closed it
        sys.stdout = None
    except (KeyboardInterrupt, Exception) as error:
        if isinstance(error, KeyboardInterrupt) or is_asked():  # which may become another error
            _end_interrupted()
        if not isinstance(error, ValueError | OSError | ImportError):
            raise
        text = str(error)
        if isinstance(error, OSError) and error.filename is None:
            text = error.strerror or text  # without [Errno 13]
        say(f"swerve: error: {text}")
        sys.exit(1)
    if is_asked():  # and code in between has caught the interrupt and gone on
        _end_interrupted()


def _end_interrupted() -> NoReturn:
    """Say that the command was interrupted, and end the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    kept = any(word.partition("=")[0] == "--work" for word in sys.argv)
    say("interrupted" + ("; the same command goes on from what --work holds" if kept else ""))
    os._exit(STATUS)  # an ordinary exit crashes where JAX is compiling; every file is complete
