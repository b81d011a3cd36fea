"""Check greedy tabular inference against golden output of Scobee & Sastry's method.

    python experiments/gridworld/golden.py FILE

FILE is a golden.json: a world, demonstrations, and the constraints picked from the first 1, 2, ...
of them. The script prints for example `95 of 95 sequences, largest KL error 3e-14`; the exit status
is 1 if a sequence of picks differs, or a KL divergence by more than 1e-9.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from swerve.reproduce.gridworld.golden import compare, read_golden

TOLERANCE = 1e-9  # nats: largest difference of a KL divergence, for rounding


def main() -> None:
    """Compare every sequence of picks."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("file", type=Path, help="a golden.json")
    golden = read_golden(parser.parse_args().file)
    same, number, error = compare(golden)
    print(f"{same} of {number} sequences, largest KL error {error:.0e}")
    sys.exit(0 if same == number and error <= TOLERANCE else 1)


if __name__ == "__main__":
    main()
