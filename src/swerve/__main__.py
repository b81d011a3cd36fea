"""`python -m swerve` is the `swerve` command."""

from swerve.cli import main

main()
