"""Systems that Swerve ships, one file each."""

from swerve.systems.pendulum import Pendulum as Pendulum
