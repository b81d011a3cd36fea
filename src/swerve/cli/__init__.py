"""The `swerve` command: one file a command, thin layers over the library."""
