"""Define the systems that come with Swerve, one file each."""

from swerve.systems.pendulum import Pendulum as Pendulum
