"""The car: which part of the track a swerving driver avoids."""
