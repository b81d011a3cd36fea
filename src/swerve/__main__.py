"""`python -m swerve` is the `swerve` command."""

import sys

if not sys.flags.safe_path:
    del sys.path[0]  # the current folder, which the command does not search either

from swerve.cli.start import main

main()
