"""The `swerve` command: a thin layer over the library.

Everything heavy is imported inside the command that needs it, so that `swerve infer` on a work
folder that holds the answer starts at once.
"""

from __future__ import annotations

import json
import os
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import cyclopts
from cyclopts import Parameter

import swerve

if TYPE_CHECKING:
    import numpy as np

    from swerve.evidence import Evidence
    from swerve.inference import Inference
    from swerve.selection import Pick
    from swerve.space import Task
    from swerve.work import Work

app = cyclopts.App(
    name="swerve",
    help="Infer which constraint a demonstrator is obeying.",
    version=swerve.__version__,
    default_parameter=Parameter(negative=()),
    suppress_keyboard_interrupt=False,
)

Problem = Annotated[
    str,
    Parameter(
        help="A shipped problem with its parameters, such as 'pendulum?max_torque=10', or "
        "path/to/file.py:name, or package.module:name."
    ),
]
Tasks = Annotated[
    Path | None,
    Parameter(help="CSV or Parquet file with columns demo, start_STATE..., goal_STATE..."),
]
WorkFolder = Annotated[
    Path | None, Parameter(help="Folder that keeps what was learned and sampled for the next call.")
]
SolverName = Annotated[
    str | None,
    Parameter(
        help="grid, soft-value, distilled, ppo, tabular, enumeration, discrete or soft-paths, with "
        "settings as in 'ppo?num_steps=2e7'. [default: what the work folder holds, else tabular "
        "where states are finitely many, grid for up to 3 states, else soft-value]"
    ),
]
Samples = Annotated[
    int | None,
    Parameter(help="Trajectories for each task, for solvers that are sampled. [default: 10000]"),
]
Method = Annotated[
    str | None,
    Parameter(
        help="smc, importance or plain, for solvers that are sampled. "
        "[default: smc, but importance for ppo]"
    ),
]
Seed = Annotated[int | None, Parameter(help="Seed of everything random. [default: 0]")]
AsJson = Annotated[bool, Parameter(name="--json", help="Print one JSON object.")]


@app.command
def infer(
    problem: Problem,
    /,
    *demonstrations: Path,
    tasks: Tasks = None,
    solver: SolverName = None,
    samples: Samples = None,
    method: Method = None,
    score: Literal["likelihood", "average"] = "likelihood",
    seed: Seed = None,
    work: WorkFolder = None,
    report: Path | None = None,
    prior_none: float = 0.5,
    tolerance: float = 0.0,
    margin: Annotated[dict[str, float] | None, Parameter(negative=())] = None,
    clearance: float | None = None,
    no_resolve: bool = False,
    greedy: int | None = None,
    as_json: AsJson = False,
) -> None:
    """Rank the hypotheses of a problem by how well they explain demonstrations.

    Learns and samples whatever the work folder does not hold yet. Without demonstrations the
    ranking is the prior one: what unconstrained trajectories enter most often comes first.

    Args:
      demonstrations: CSV or Parquet files whose columns include the states' names.
      score: likelihood, or average: the paper's average violation probability.
      report: HTML page to write, with the picture, the ranking and the diagnostics.
      prior_none: Probability of no constraint before the demonstrations; the hypotheses share the
        rest.
      tolerance: Probability with which a demonstration ignores the constraint.
      margin: How deep inside a hypothesis a demonstration must be to have entered it, for states
        measured with noise: --margin.x 0.05, in the state's unit.
      clearance: Leave a hypothesis out for tasks that start or end within this distance of it.
      no_resolve: Leave the score of what next to no trajectory avoids at what the samples tell, a
        lower bound, instead of working out what avoiding it takes, which may need minutes.
      greedy: Pick up to this many constraints as well, one after another, each for what those
        before it leave to be explained.
    """
    from swerve.inference import infer as infer_constraints

    if report is not None:
        _check_report(report)
    if greedy is not None:
        _check_greedy(greedy, demonstrations)
    job = _work(problem, work, solver, seed, method, samples)
    found = _read(job, demonstrations, tasks)
    asked = _asked_tasks(job, found, tasks)
    evidence = job.evidence(asked)
    if not found and asked is not None:
        evidence = _only(evidence, asked)
    rank = partial(
        infer_constraints,
        demonstrations=found,
        score=score,
        prior=prior_none,
        tolerance=tolerance,
        margin=margin,
        clearance=clearance,
    )
    result = rank(evidence)
    if not no_resolve:
        result = rank(job.resolved(result))
    picks = None if greedy is None else _picks(job, result, greedy)
    _show(result, picks, report, as_json)


@app.command
def fit_beta(
    problem: Problem,
    /,
    *demonstrations: Path,
    tasks: Tasks = None,
    solver: SolverName = None,
    samples: Samples = None,
    method: Method = None,
    confidence: float = 0.95,
    seed: Seed = None,
    work: WorkFolder = None,
    as_json: AsJson = False,
) -> None:
    """Estimate beta, how strictly demonstrators follow the reward, by maximum likelihood.

    The demonstrations must be ones that no constraint but the known ones held back. Learns and
    samples whatever the work folder does not hold yet, at the problem's own beta.

    Args:
      demonstrations: CSV or Parquet files with the states and the actions.
      confidence: Of the interval.
    """
    from swerve.diagnosis import data_warnings

    job = _work(problem, work, solver, seed, method, samples)
    found = _read(job, demonstrations, tasks)
    if not found:
        raise ValueError("give at least one demonstration: beta is estimated from them")
    evidence = job.evidence(_asked_tasks(job, found, tasks))
    for warning in data_warnings(swerve.infer(evidence, found)):
        _say(f"warning: {warning}")
    fit = swerve.fit_beta(job.problem, evidence, found, confidence)
    print(json.dumps(fit.to_json()) if as_json else fit)


@app.command
def watch(
    problem: Problem,
    /,
    *,
    work: Path,
    tasks: Tasks = None,
    solver: SolverName = None,
    samples: Samples = None,
    method: Method = None,
    prior: float | None = None,
    tolerance: float = 0.0,
    seed: Seed = None,
) -> None:
    """Watch demonstrations state by state: JSON lines in, JSON lines out.

    A line in is an object such as {"theta": 3.1, "omega": 0.2, "t": 0.05, "id": "a"}, or an array
    of the states; {"end": true, "id": "a"} ends a demonstration. Learns whatever the work folder
    does not hold yet first.

    Args:
      tasks: CSV or Parquet file; a demonstration's id names its row, unless there is only one.
        [default: the task that the work folder holds, if it is only one]
      prior: Probability of no constraint. [default: 0.5]
      tolerance: Probability with which a demonstration ignores the constraint.
    """
    from swerve.demonstrations import read_tasks
    from swerve.space import Task
    from swerve.watch import Watch, foresight_of
    from swerve.watch import watch as answer_lines

    job = _work(problem, work, solver, seed, method, samples)
    asked = _asked_tasks(job, [], tasks)
    evidence = job.evidence(asked)
    if tasks is not None:
        named = read_tasks(tasks, job.record.space, job.record.goal_names)
    else:
        rows = zip(*evidence.tasks, strict=True)
        named = {str(k): Task(*row) for k, row in enumerate(rows)}
    watched = Watch(evidence, foresight_of(job, evidence), named, prior=prior, tolerance=tolerance)
    _say("watching: one state a line")
    answer_lines(sys.stdin, watched.answer, sys.stdout)


@app.command
def learn(
    problem: Problem,
    /,
    *,
    work: Path,
    solver: SolverName = None,
    seed: Seed = None,
) -> None:
    """Learn the nominal distribution of a problem into a work folder.

    Training that is interrupted goes on where it stopped when the same command is given again.
    A picture of how it went is written beside what was learned.
    """
    job = _work(problem, work, solver, seed)
    nominal = job.nominal()
    _say(f"learned with {nominal.solver!r}; next: swerve sample or swerve infer, --work {work}")


@app.command
def sample(
    problem: Problem,
    /,
    *,
    work: Path,
    tasks: Tasks = None,
    solver: SolverName = None,
    samples: Samples = None,
    method: Method = None,
    seed: Seed = None,
    as_json: AsJson = False,
) -> None:
    """Sample the nominal distribution for tasks, so that inference is instant afterwards."""
    from swerve import wording
    from swerve.diagnosis import data_warnings
    from swerve.inference import infer as prior

    job = _work(problem, work, solver, seed, method, samples)
    evidence = job.evidence(_asked_tasks(job, [], tasks))
    inference = prior(evidence)
    rows = inference.to_json()["diagnostics"]
    if as_json:
        print(json.dumps({"num_trajectories": evidence.num_trajectories, "tasks": rows}))
        return
    print(f"{wording.counted(evidence.num_tasks, 'task')}, {wording.samples(evidence)}")
    print(
        f"{'task':>4}  {'ESS':>8}  {'KL [nats]':>9}  {'log Z_0':>9}  {'spread':>6}  start -> goal"
    )
    for k, row in enumerate(rows):
        print(
            f"{k:>4}  {row['effective_sample_size']:>8.0f}  {row['kl']:>9.3f}  "
            f"{row['log_partition']:>9.3f}  {row['island_spread']:>6.3f}  "
            f"{_numbers(row['start'])} -> {_numbers(row['goal'])}"
        )
    for warning in data_warnings(inference):
        _say(f"warning: {warning}")


@app.command
def demonstrate(
    problem: Problem,
    /,
    *,
    constraint: int,
    out: Path,
    num: int | None = None,
    tasks: Tasks = None,
    solver: str = "grid",
    seed: int = 0,
) -> None:
    """Make demonstrations that obey one of the hypotheses, by sampling pi_c with the grid solver.

    Args:
      constraint: Index of the hypothesis to obey.
      out: Folder to write demo_000.csv, demo_001.csv, ... and tasks.csv into.
      num: How many, of as many tasks drawn from the MDP. [default: 10, or one for each of --tasks]
      solver: grid, with settings as in 'grid?num_points=81'.
    """
    from swerve.demonstrations import new_files, read_tasks, write_demonstrations
    from swerve.demonstrators.boltzmann import demonstrate as draw
    from swerve.store import check_writable
    from swerve.tasks import draw_tasks

    if tasks is not None and num is not None:
        raise ValueError("give --num or --tasks, not both: there is one demonstration a task")
    if num is not None and num < 1:
        raise ValueError(f"--num: expected at least 1, got {num}")
    check_writable(out)
    job = _work(problem, None)
    record, forbidden = job.record, job.record.hypotheses.constraint(constraint)
    if tasks is not None:
        rows = read_tasks(tasks, record.space, record.goal_names)
        batch = swerve.Task.stack(list(rows.values()))
        names = [f"demo_{row.removeprefix('demo_')}" for row in rows]
    else:
        batch = draw_tasks(job.problem, num or 10, avoid=[forbidden], seed=seed)
        names = [f"demo_{k:03d}" for k in range(num or 10)]
    new_files(out, names)  # before the work
    made = draw(job.problem, forbidden, batch, names=names, solver=solver, seed=seed, progress=True)
    write_demonstrations(
        out, made, record.space, action_names=record.action_names, goal_names=record.goal_names
    )
    _say(f"wrote {len(made)} demonstrations that avoid {forbidden.name} to {out}")


@app.command
def reproduce(
    name: Literal["gridworld", "human-walk"],
    /,
    *,
    out: Path | None = None,
    data: Path | None = None,
    quick: bool = False,
    as_json: AsJson = False,
) -> None:
    """Regenerate a published result: figures as PNG and SVG, the numbers in them as CSV.

    gridworld: false positives and KL divergence against the number of demonstrations (Scobee and
    Sastry, 2019), and what someone under no constraint enters; one to two minutes.

    human-walk: the obstacle that people in a room walk around, from their tracks; two to three
    minutes. --data names a folder of tracks.csv, with columns t [s], track, x, y
    [m], and room.png, in which free floor is light; room.json tells where the picture lies,
    {"corner": [x, y], "cell": side of a pixel} [m], unless that is [-11, -10] and 0.01.

    Args:
      name: The result.
      out: Folder to write into; files of the same names are replaced. human-walk does without.
      data: Golden output, a golden.json, to take demonstrations from and to compare with.
        [default: demonstrations drawn in a world of Swerve's own]; of human-walk, the folder.
      quick: Fewer numbers of demonstrations; of human-walk, wider steps of beta.
      as_json: Print one JSON object; human-walk alone.
    """
    from swerve.store import check_writable

    if data is not None and not data.exists():
        raise FileNotFoundError(f"--data {data}: no such file; check the path")
    if out is not None:
        check_writable(out)
    if name == "human-walk":
        _reproduce_human_walk(data, out, quick, as_json)
    elif out is None or as_json:
        raise ValueError("gridworld: give --out, a folder for its figures and numbers, not --json")
    else:
        _reproduce_gridworld(data, out, quick)


def _reproduce_gridworld(data: Path | None, out: Path, is_quick: bool) -> None:
    from swerve.reproduce import gridworld, gridworld_figures

    result = gridworld.reproduce(data, is_quick=is_quick, progress=True)
    written = gridworld_figures.write(result, out)
    print(gridworld_figures.table(result))
    _say(f"wrote {', '.join(path.name for path in written)} to {out}")


def _reproduce_human_walk(
    data: Path | None, out: Path | None, is_quick: bool, as_json: bool
) -> None:
    from swerve.reproduce import human_walk, human_walk_figures

    if data is None or not data.is_dir():
        raise ValueError(f"--data {data}: expected a folder of tracks.csv and room.png")
    result = human_walk.reproduce(data, is_quick=is_quick, progress=True)
    print(json.dumps(human_walk.to_json(result)) if as_json else human_walk_figures.table(result))
    if out is not None:
        written = human_walk_figures.write(result, out)
        _say(f"wrote {', '.join(path.name for path in written)} to {out}")


@app.command
def demo(*, work: WorkFolder = None, report: Path = Path("swerve-demo.html")) -> None:
    """Show what Swerve does: bundled demonstrations, minutes of work, a report at the end.

    A pendulum is swung to its goals as if nothing were in the way, except that there is: find out
    where. The demonstrations were made by `swerve demonstrate`.
    """
    from swerve.demo import FOLDER, PROBLEM

    files = sorted(FOLDER.glob("demo_*.csv"))
    _say(f"{len(files)} demonstrations of {PROBLEM} in {FOLDER}")
    infer(PROBLEM, *files, tasks=FOLDER / "tasks.csv", work=work, report=report)


def main() -> None:
    """Run the command; errors become one line and an exit status."""
    try:
        app(sys.argv[1:])
    except KeyboardInterrupt:
        kept = any(word.partition("=")[0] == "--work" for word in sys.argv)
        _say("interrupted" + ("; the same command goes on from what --work holds" if kept else ""))
        os._exit(130)  # an ordinary exit crashes where JAX is compiling; every file is complete
    except BrokenPipeError:  # whoever read the output, such as head, has seen enough
        sys.stdout = None
    except (ValueError, OSError) as error:
        _say(f"swerve: error: {error}")
        sys.exit(1)


def _work(
    problem: str,
    folder: Path | None,
    solver: str | None = None,
    seed: int | None = None,
    method: str | None = None,
    samples: int | None = None,
) -> Work:
    from swerve.settings import Settings
    from swerve.work import Work

    return Work(problem, folder, Settings(solver, seed, method, samples), say=_say, progress=True)


def _check_report(report: Path) -> None:
    """Make sure that the report can be written before the work that it is about."""
    from swerve.store import check_writable

    if report.is_dir():
        raise IsADirectoryError(f"--report {report} is a folder; name a file, such as report.html")
    check_writable(report.parent)


def _read(job: Work, paths: tuple[Path, ...], tasks: Path | None) -> list[Any]:
    """Read demonstration files as the problem wants them."""
    from swerve.demonstrations import read_demonstrations

    if not paths:
        return []
    record = job.record
    return read_demonstrations(
        paths,
        record.space,
        tasks=tasks,
        goal_names=record.goal_names,
        action_names=record.action_names,
        goal_of=job.goal_of if tasks is None else None,
    )


def _asked_tasks(job: Work, demonstrations: list[Any], tasks: Path | None) -> Task | None:
    """Return the tasks of the demonstrations, or else of the file, or else None."""
    from swerve.demonstrations import read_tasks
    from swerve.space import Task

    if demonstrations:
        return Task.stack([demonstration.task for demonstration in demonstrations])
    if tasks is None:
        return None
    return Task.stack(list(read_tasks(tasks, job.record.space, job.record.goal_names).values()))


def _only(evidence: Evidence, tasks: Task) -> Evidence:
    """Return the part of evidence that is about these tasks."""
    indices = {evidence.match(type(tasks)(*task)) for task in zip(*tasks, strict=True)}
    return evidence.select(sorted(indices))


def _check_greedy(most: int, demonstrations: tuple[Path, ...]) -> None:
    """Make sure that there is something to pick from before the work."""
    if most < 1:
        raise ValueError(f"--greedy: expected a number of picks >= 1, got {most}")
    if not demonstrations:
        raise ValueError("--greedy: constraints are picked from demonstrations: give at least one")


def _picks(job: Work, result: Inference, most: int) -> list[Pick]:
    """Return what greedy selection picks from a result."""
    from swerve.selection import greedy

    nominal: Any = job.nominal() if result.evidence.is_exact else None
    return greedy(result, nominal, most=most)


def _show(result: Inference, picks: list[Pick] | None, report: Path | None, as_json: bool) -> None:
    """Print a result and what was picked, and write its report if one is asked for."""
    from swerve import listing

    for warning in result.warnings:
        _say(f"warning: {warning}")
    if as_json:
        picked = {} if picks is None else {"greedy": listing.picks_to_json(result, picks)}
        print(json.dumps(result.to_json() | picked))
    else:
        print(result.evidence.problem.summary)
        print(result.headline)
        print(result.belief)
        print(result.table())
        if picks is not None:
            print(listing.picks_table(result, picks))
        print(result.verdicts())
    if report is not None:
        result.report(report)
        _say(f"report: {report}")


def _numbers(values: np.ndarray | list[float]) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in values) + ")"


def _say(text: str) -> None:
    print(text, file=sys.stderr)
