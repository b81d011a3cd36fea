"""Try many inputs of each target: `python -m fuzz --inputs 1000000 --processes 2`.

`python -m fuzz --target csv --first 1234 --inputs 1` repeats one input.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed

from fuzz.targets import TARGETS, tried

BATCH = 500  # inputs tried between two lines of progress, at least


def jobs(num: int, first: int, only: str | None) -> list[tuple[str, int, int]]:
    """Return batches of inputs by target, first number and count, the targets in turn."""
    made = []
    for kind in TARGETS:
        if only in (None, kind.name):
            total = num if only else num * kind.share // 100
            made += [(kind.name, first + k, min(BATCH, total - k)) for k in range(0, total, BATCH)]
    return sorted(made, key=lambda job: job[1])


def main() -> int:
    """Try the inputs in several processes, and say how far they are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--target", choices=[kind.name for kind in TARGETS])
    chosen = parser.parse_args()
    todo = jobs(chosen.inputs, chosen.first, chosen.target)
    total = sum(job[2] for job in todo)
    began, done, failures, due = time.monotonic(), 0, 0, 0.0
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(chosen.processes, context) as pool:
        jobs_done = as_completed([pool.submit(tried, *job) for job in todo])
        for number, job in enumerate(jobs_done, 1):
            num, failure = job.result()
            done += num
            if failure:
                failures += 1
                print(failure, flush=True)
            elapsed = time.monotonic() - began
            if elapsed > due or number == len(todo):
                due = elapsed + 10.0
                rate = done / elapsed
                left = (total - done) / rate if number < len(todo) else 0.0
                print(
                    f"{done:,} of {total:,} inputs tried, {failures} failures, "
                    f"{rate:.0f} a second, {left / 60:.0f} min left",
                    flush=True,
                )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
