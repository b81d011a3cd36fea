"""A cart with static fields of every kind."""

from __future__ import annotations

import equinox as eqx
from support.reference import Cart


class Rigging(eqx.Module):
    kind: str = eqx.field(static=True, default="sloop")


class Ship(Cart):
    buoys: tuple = eqx.field(default=(1.0, 2.0), static=True)
    rigging: Rigging = Rigging()
    wind: object = None
