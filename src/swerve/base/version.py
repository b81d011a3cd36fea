"""Name the release of Swerve."""

VERSION = "0.1.0"
