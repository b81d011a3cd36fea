"""Ranks of the truth: those of inference on the same demonstrations, and exact averages."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from evidence_factory import make_evidence

