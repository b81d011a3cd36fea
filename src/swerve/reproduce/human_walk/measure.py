"""Measure where the obstacle is that people walk around, from their tracks through a room.

The model of people is `Walker`: soft shortest paths over the floor, with the walls as the only
known constraint. The hypotheses are all squares of 0.75 m that overlap by three quarters and have
some floor in them. Squares within 0.75 m of the ends of a track do not count for this track.
Answers are exact.

The module `beta` describes the choice of beta.

Shapes: D tracks, H hypotheses, N numbers of tracks, R random subsets, P picks.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from swerve.answer import Inference, infer
from swerve.base.progress import progress_bar
from swerve.base.space import Task
from swerve.constraints.occupancy import Occupancy
from swerve.hypotheses.windows import WindowHypotheses, windows
from swerve.inference.greedy import Pick, greedy
from swerve.inference.posterior import NONE, posterior
from swerve.problem.problem import Problem
from swerve.reproduce.human_walk.beta import CLEARANCE, FIRST, RULE, Beta, choose_beta, ladder
from swerve.reproduce.human_walk.tracks import Room, Tracks, read_room, read_tracks
from swerve.sampling.sample import sample
from swerve.solvers.exact.soft_paths import PathNominal, SoftPaths
from swerve.systems.walker import Walker

WIDTH, OVERLAP = 0.75, 4  # m: width of a square; squares over each point, along an axis
MARGIN = 3  # cells of the lattice around the floor, more than the longest step
NUM_PICKS = 3  # largest number of picks of the greedy search
NUM_SUBSETS = 300  # random subsets of each size
SIZES = (1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 50, 70, 100, 150, 200, 300, 500)  # tracks of a subset
INTERVAL = (5.0, 95.0)  # percentiles over the subsets


class Answer(NamedTuple):
    """Inference at one beta.

    Attributes:
      beta: the beta [nats/m].
      inference: ranking of all squares, one constraint at a time.
      picks: picks of the greedy search, in order.
      gains: [P, D] nats that each pick adds to the log-likelihood of each track.
      elsewhere: index of the best square that does not overlap the first pick; None without one.
    """

    beta: float
    inference: Inference
    picks: list[Pick]
    gains: np.ndarray
    elsewhere: int | None


class Belief(NamedTuple):
    """Posterior by random subsets of the tracks.

    Attributes:
      sizes: [N] numbers of tracks of a subset.
      near: [N, R] probability of a constraint that overlaps the first pick of all tracks.
      none: [N, R] probability of no constraint.
      gain: [N, R] log-likelihood ratio of the first pick, nats.
    """

    sizes: list[int]
    near: np.ndarray
    none: np.ndarray
    gain: np.ndarray


class Result(NamedTuple):
    """Measurements.

    Attributes:
      room: the map.
      tracks: the tracks of people.
      beta: the chosen beta and its scores.
      answer: inference at the chosen beta.
      sensitivity: inference at about half of the chosen beta, at it and at twice as much.
      belief: posterior as a function of the number of tracks.
    """

    room: Room
    tracks: Tracks
    beta: Beta
    answer: Answer
    sensitivity: list[Answer]
    belief: Belief


def reproduce(
    data: Path, *, is_quick: bool = False, seed: int = 0, progress: bool = False
) -> Result:
    """Find what the people in a room walk around.

    Args:
      data: folder of `tracks.csv` and `room.png`.
      is_quick: whether to try fewer betas.
      seed: seed of random sets of tracks.
      progress: whether to show a progress bar.

    Raises:
      OSError: if a file is missing.
      ValueError: if a file cannot be understood, or a track cannot be explained.
    """
    room = read_room(data)
    tracks = read_tracks(data, room)
    nominal = SoftPaths().learn(problem_of(room))
    generator = np.random.default_rng(seed)
    least = _walker(room).least_beta
    tried = ladder(least, is_quick)
    with progress_bar("walking", 2.0 * len(tried) + 20.0, progress) as advance:
        beta = _beta(nominal, tracks, tried, generator, lambda num: advance(num, "choosing beta"))
        answers = []
        for value in (max(0.5 * beta.value, FIRST * least), beta.value, 2.0 * beta.value):
            answers.append(answer_at(nominal.at_beta(value), tracks))
            advance(5.0, "inferring")
    belief = belief_of(answers[1], generator)
    return Result(room, tracks, beta, answers[1], answers, belief)


def _beta(
    nominal: PathNominal,
    tracks: Tracks,
    tried: np.ndarray,
    generator: np.random.Generator,
    advance: Callable[[float], None],
) -> Beta:
    """Choose beta, and a second time with the first pick in force if a constraint is likely."""
    tasks = Task.stack([item.task for item in tracks.used])
    start = infer(sample(nominal, tasks), tracks.used, clearance=CLEARANCE)

    def choose(avoiding: int | None) -> Beta:
        beta = choose_beta(nominal, start, tried, generator, avoiding, lambda: advance(1.0))
        advance(float(len(tried) - len(beta.tried)))
        return beta

    beta = choose(None)
    picks = answer_at(nominal.at_beta(beta.value), tracks, most=1).picks
    advance(5.0)
    if picks and picks[0].log_odds > 0.0:
        return choose(picks[0].hypothesis)
    advance(float(len(tried)))
    return beta


def problem_of(room: Room, beta: float | None = None) -> Problem:
    """Return the problem of a room: known walls, and hypotheses of squares with floor."""
    walker = _walker(room)
    corner = WIDTH * np.floor(room.floor[:, 0] / WIDTH)
    end = WIDTH * np.ceil(room.floor[:, 1] / WIDTH)
    (x, y) = ((float(low), float(high), WIDTH) for low, high in zip(corner, end, strict=True))
    return Problem(
        walker,
        windows(x=x, y=y, overlap=OVERLAP),
        beta=FIRST * walker.least_beta if beta is None else beta,
        measure="counting",
        known=[room.walls],
    )


def _walker(room: Room) -> Walker:
    """Return a walker whose lattice covers the floor."""
    spacing = Walker.spacing
    low = spacing * (np.floor(room.floor[:, 0] / spacing) - MARGIN)
    high = spacing * (np.ceil(room.floor[:, 1] / spacing) + MARGIN)
    (x, y) = zip(low.tolist(), high.tolist(), strict=True)
    return Walker(bounds=(x, y))


def squares(hypotheses: Any) -> np.ndarray:
    """Return (x low, x high, y low, y high) [H, 4] of each window [m]."""
    assert isinstance(hypotheses, WindowHypotheses)
    (x_low, x_high), (y_low, y_high) = (hypotheses.edges()[name] for name in ("x", "y"))
    x, y = np.meshgrid(np.arange(len(x_low)), np.arange(len(y_low)), indexing="ij")
    sides = (x_low[x], x_high[x], y_low[y], y_high[y])
    return np.stack([side.ravel() for side in sides], axis=1)


def answer_at(nominal: PathNominal, tracks: Tracks, most: int = NUM_PICKS) -> Answer:
    """Infer from all tracks at the beta of a nominal distribution."""
    demonstrations = tracks.used
    tasks = Task.stack([item.task for item in demonstrations])
    evidence = sample(nominal, tasks)
    hypotheses, walls = evidence.problem.hypotheses, evidence.problem.known[0]
    assert isinstance(walls, Occupancy)
    inference = infer(
        evidence, demonstrations, clearance=CLEARANCE, prior=floor_prior(hypotheses, walls)
    )
    picks = greedy(inference, nominal, threshold=0.0, most=most)
    log_partition = [evidence.log_partition, *(pick.log_partition for pick in picks)]
    gains = -np.diff(np.array(log_partition), axis=0)[:, inference.task_of]
    elsewhere = None
    if picks:
        apart = ~overlapping(squares(hypotheses), picks[0].hypothesis)
        left = [int(index) for index in inference.ranking if apart[index]]
        elsewhere = left[0] if left else None
    return Answer(nominal.problem.beta, inference, picks, gains, elsewhere)


def overlapping(found: np.ndarray, index: int) -> np.ndarray:
    """Return whether each square [H] of found [H, 4] overlaps the square with an index."""
    x_low, x_high, y_low, y_high = found.T
    x, y = found[index, :2], found[index, 2:]
    return (x_low < x[1]) & (x_high > x[0]) & (y_low < y[1]) & (y_high > y[0])


def floor_prior(hypotheses: Any, room: Occupancy) -> np.ndarray:
    """Return the prior [H + 1]: half of it for no constraint, the rest for squares with floor."""
    free = np.pad(np.cumsum(np.cumsum(~room.blocked, axis=0), axis=1), ((1, 0), (1, 0)))
    edges = squares(hypotheses).reshape(-1, 2, 2)  # of x and of y
    places = np.round((edges - np.array(room.corner)[:, None]) / room.cell).astype(int)
    limits = np.array(room.blocked.shape[::-1])[:, None]
    (left, right), (low, high) = np.clip(places, 0, limits).transpose(1, 2, 0)
    has_floor = free[high, right] - free[low, right] - free[high, left] + free[low, left] > 0
    return np.concatenate([[NONE], (1.0 - NONE) * has_floor / has_floor.sum()])


def belief_of(answer: Answer, generator: np.random.Generator) -> Belief:
    """Return the posterior by random subsets of the tracks, for each size."""
    inference, num = answer.inference, len(answer.inference.demonstrations)
    sizes = [*(size for size in SIZES if size < num), num]
    shape = len(sizes), NUM_SUBSETS
    near, none, gain = (np.zeros(shape) for _ in range(3))
    if not answer.picks:
        none += 1.0
        return Belief(sizes, near, none, gain)
    first = answer.picks[0].hypothesis
    is_near = overlapping(squares(inference.evidence.problem.hypotheses), first)
    impossible = np.where(inference.impossible, -np.inf, 0.0)
    for k, size in enumerate(sizes):
        for r in range(NUM_SUBSETS):
            chosen = generator.choice(num, size, replace=False)
            log_likelihood = inference.contributions[chosen].sum(axis=0) + impossible
            found = posterior(log_likelihood, inference.prior)
            none[k, r], near[k, r] = found[0], found[1:][is_near].sum()
            gain[k, r] = log_likelihood[first]
    return Belief(sizes, near, none, gain)


def to_json(result: Result) -> dict[str, Any]:
    """Return the measurements as JSON data; gains are of all tracks together, in nats."""
    beta, answer = result.beta, result.answer
    posterior_found = answer.inference.posterior
    return {
        "num_tracks": len(result.tracks.used),
        "left_out": result.tracks.left_out,
        "beta": beta.value,
        "beta_interval": list(beta.interval),
        "beta_rule": RULE,
        "beta_at_boundary": beta.at_boundary,
        "least_beta": beta.least,
        "num_hypotheses": int(np.count_nonzero(answer.inference.prior[1:])),
        "probability_none": posterior_found.none,
        "picks": picks_json(answer),
        "elsewhere": elsewhere_json(answer),
        "sensitivity": [
            {
                "beta": one.beta,
                "probability_none": one.inference.posterior.none,
                "picks": picks_json(one),
                "elsewhere": elsewhere_json(one),
            }
            for one in result.sensitivity
        ],
        "belief": [
            {
                "num_tracks": size,
                "near_first_pick": np.percentile(near, (50.0, *INTERVAL)).tolist(),
                "probability_none": float(none.mean()),
                "gain_nats": float(gain.mean()),
            }
            for size, near, none, gain in zip(*result.belief, strict=True)
        ],
    }


def picks_json(answer: Answer) -> list[dict[str, Any]]:
    """Return the picks in order as JSON data, each with its gain over the picks before it."""
    found = squares(answer.inference.evidence.problem.hypotheses)
    num = answer.gains.shape[1]
    return [
        {
            "index": pick.hypothesis,
            "centre": centre(found[pick.hypothesis]),
            "width": WIDTH,
            "gain_nats": pick.total_gain,
            "gain_per_track": pick.gain,
            "standard_error": float(gains.std(ddof=1) * math.sqrt(num)),
            "log_odds": pick.log_odds,
        }
        for pick, gains in zip(answer.picks, answer.gains, strict=True)
    ]


def elsewhere_json(answer: Answer) -> dict[str, Any] | None:
    """Return the best square that does not overlap the first pick as JSON data, by itself alone."""
    if answer.elsewhere is None:
        return None
    inference, index = answer.inference, answer.elsewhere
    found = squares(inference.evidence.problem.hypotheses)[index]
    gain = float(inference.log_likelihood[index])
    return {"index": index, "centre": centre(found), "gain_nats": gain}


def centre(square: np.ndarray) -> list[float]:
    """Return the middle (x, y) of a square [4], to a millimetre."""
    return square.reshape(2, 2).mean(axis=1).round(3).tolist()
