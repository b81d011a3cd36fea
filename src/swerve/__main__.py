"""`python -m swerve` is the `swerve` command."""

from swerve.cli.app import main

main()
