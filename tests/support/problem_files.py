"""A user's problem in files that import one another."""

from __future__ import annotations

ROBOT = """
import swerve
from helper import cells

class Cart(swerve.Pendulum):
    '''A class of the user's own.'''

problem = swerve.Problem(Cart(max_torque=2.0, num_steps=3), cells, beta=0.5)
number = 3

def make(max_torque: float, num_steps: int = 3, cells_only: bool = False) -> object:
    if cells_only:
        return cells
    return swerve.Problem(Cart(max_torque, num_steps=num_steps), cells)
"""
HELPER = """
import shapes
cells = shapes.cells()
"""
SHAPES = """
import swerve

def cells():
    return swerve.grid(theta=(0.0, 6.0, 3))
"""


def alone(name: str) -> str:
    """A problem without neighbours, whose class has this name."""
    text = ROBOT.replace("from helper import cells", "cells = swerve.grid(theta=(0.0, 6.0, 3))")
    return text.replace("Cart", name)
