"""Run the `swerve` command: register the commands, turn errors into one line.

A command imports heavy packages inside its function, so that `swerve infer` on a work folder that
holds the answer starts at once.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import cyclopts
from cyclopts import Parameter

from swerve.base.decimals import decimal_number, whole_decimal
from swerve.base.version import VERSION
from swerve.cli.demo import demo
from swerve.cli.demonstrate import demonstrate
from swerve.cli.fit_beta import fit_beta
from swerve.cli.infer import infer
from swerve.cli.learn import learn, sample
from swerve.cli.options import say
from swerve.cli.reproduce import reproduce
from swerve.cli.watch import watch


def _convert(kind: Any, tokens: Any) -> Any:
    """Convert the texts of an option; numbers are read as everywhere, by `base.decimals`."""
    return cyclopts.convert(kind, tokens, converter=_convert_one)


def _convert_one(kind: Any, text: str) -> Any:
    if kind is float:
        return decimal_number(text)
    return whole_decimal(text) if kind is int else cyclopts.convert(kind, [text])


app = cyclopts.App(
    name="swerve",
    help="Infer which constraint a demonstrator is obeying.",
    version=VERSION,
    default_parameter=Parameter(negative=(), converter=_convert),
    suppress_keyboard_interrupt=False,
)
for command in (infer, fit_beta, watch, learn, sample, demo, demonstrate, reproduce):
    app.command(command)


def main() -> None:
    """Run the command; errors become one line and an exit status."""
    try:
        app(sys.argv[1:])
    except KeyboardInterrupt:
        kept = any(word.partition("=")[0] == "--work" for word in sys.argv)
        say("interrupted" + ("; the same command goes on from what --work holds" if kept else ""))
        os._exit(130)  # an ordinary exit crashes where JAX is compiling; every file is complete
    except BrokenPipeError:  # the reader of the output, such as head, has closed it
        sys.stdout = None
    except (ValueError, OSError, ImportError) as error:
        say(f"swerve: error: {error}")
        sys.exit(1)
