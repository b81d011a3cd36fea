"""The quick start: `swerve demo`, on a problem and demonstrations that this project made.

Made by `swerve demonstrate "pendulum?max_torque=10" --constraint 55 --num 24 --out FOLDER`.
"""

from __future__ import annotations

from pathlib import Path

from swerve.cli.infer import check_report, infer
from swerve.cli.options import WorkPath, say

PROBLEM = "pendulum?max_torque=10"
FOLDER = Path(__file__).parents[1] / "data" / "pendulum"


def demo(*, work: WorkPath = None, report: Path = Path("swerve-demo.html")) -> None:
    """Show what Swerve does: bundled demonstrations, minutes of work, a report at the end.

    A pendulum is swung to its goals as if nothing were in the way, except that one region is
    avoided: find out which. The demonstrations were made by `swerve demonstrate`.
    """
    check_report(report)
    files = sorted(FOLDER.glob("demo_*.csv"))
    say(f"{len(files)} demonstrations of {PROBLEM} in {FOLDER}")
    infer(PROBLEM, *files, tasks=FOLDER / "tasks.csv", work=work, report=report)
