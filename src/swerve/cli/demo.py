"""The bundled quick start: a problem and demonstrations that this project made.

Made by `swerve demonstrate "pendulum?max_torque=10" --constraint 55 --num 24 --out FOLDER`.
"""

from pathlib import Path

PROBLEM = "pendulum?max_torque=10"
FOLDER = Path(__file__).parents[1] / "data" / "pendulum"
