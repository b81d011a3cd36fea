"""Time Stable-Baselines3 at the job of Swerve's PPO, on the same machine.

The job is the goal-conditioned pendulum of the paper's section IV with torques in [-10, 10],

    theta'' = sin(theta) + u,    R = -80 |s_T - goal|^2 - sum_t 0.05 u_t^2 dt,

300 Runge-Kutta steps of 1/60 s, a new start and goal in each episode, the observation of Swerve's
networks, a 64 x 64 tanh policy and a 64 x 64 value. Simulation is plain Python on floats, the
fastest way for one environment at a time.

The work of a step is the same, the objective is not. Swerve pays -log pi(a | s) / beta as part of
the reward, so that the entropy of the future counts in returns and advantages, as the nominal
distribution requires. Stable-Baselines3 offers only `ent_coef`, a bonus on the entropy at the
visited states that no return includes; it is used here with the same weight 1 / beta. So only the
speed is compared, not the policy.

Steps per second of processor time are given too: with one thread they are about equal to steps per
second of the clock on an idle machine. With two threads, torch waits for the slower one at every
layer, on a busy machine most of the time, which says nothing about the library. So one thread is
the default.

Run it: python benchmarks/stable_baselines.py [--num-threads 2] [--batch-size 300] ...
"""

# The libraries compared with are an extra; the type checker runs with and without them.
# pyright: reportMissingImports=false

import argparse
import importlib.util
import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

DT = 1.0 / 60.0  # s
NUM_STEPS = 300
TORQUES = (-10.0, -5.0, 0.0, 5.0, 10.0)
TERMINAL_WEIGHT = 80.0
TORQUE_WEIGHT = 0.05
MAX_START_SPEED = 2.0  # rad/s
SPEED_SCALE = 12.0  # rad/s, half the extent of the state bounds
BETA = 0.67
NUM_FEATURES = 10


def step_state(theta: float, omega: float, torque: float) -> tuple[float, float]:
    """Return (theta, omega) one Runge-Kutta step of theta'' = sin(theta) + torque later."""
    half = 0.5 * DT
    a1 = math.sin(theta) + torque
    w2 = omega + half * a1
    a2 = math.sin(theta + half * omega) + torque
    w3 = omega + half * a2
    a3 = math.sin(theta + half * w2) + torque
    w4 = omega + DT * a3
    a4 = math.sin(theta + DT * w3) + torque
    return (
        theta + DT / 6.0 * (omega + 2.0 * w2 + 2.0 * w3 + w4),
        omega + DT / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
    )


def angle_difference(start: float, end: float) -> float:
    """Return end - start along the shorter arc [rad]."""
    return (end - start + math.pi) % (2.0 * math.pi) - math.pi


def terminal_reward(theta: float, omega: float, goal: tuple[float, float]) -> float:
    """Return -80 |s_T - goal|^2, the angle's difference along the shorter arc."""
    return -TERMINAL_WEIGHT * (angle_difference(theta, goal[0]) ** 2 + (goal[1] - omega) ** 2)


def observe(theta: float, omega: float, step: int, goal: tuple[float, float]) -> np.ndarray:
    """Return the observation [10]: state, time to go, goal, difference to the goal."""
    to_go = (NUM_STEPS - step) / NUM_STEPS
    return np.array(
        (
            omega / SPEED_SCALE,
            math.sin(theta),
            math.cos(theta),
            to_go,
            math.sqrt(to_go),
            goal[1] / SPEED_SCALE,
            math.sin(goal[0]),
            math.cos(goal[0]),
            angle_difference(theta, goal[0]) / math.pi,
            (goal[1] - omega) / SPEED_SCALE,
        ),
        np.float32,
    )


def check_installed() -> None:
    """Raise ModuleNotFoundError, with advice, unless all compared libraries are installed."""
    for name in ("gymnasium", "torch", "stable_baselines3"):
        if importlib.util.find_spec(name) is None:
            raise ModuleNotFoundError(
                f"this benchmark compares with Stable-Baselines3, and {name} is not installed: "
                "pip install swerve[benchmark]",
                name=name,
            )


def make_environment() -> Any:
    """Return the goal-conditioned pendulum as a Gymnasium environment.

    An episode ends at the horizon as terminated, not truncated: the time to go is observed, so
    nothing is left to bootstrap from.
    """
    import gymnasium

    class PendulumEnvironment(gymnasium.Env):
        action_space = gymnasium.spaces.Discrete(len(TORQUES))
        observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (NUM_FEATURES,), np.float32)

        def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
            super().reset(seed=seed)
            high = (2.0 * math.pi, MAX_START_SPEED, 2.0 * math.pi, MAX_START_SPEED)
            low = (0.0, -MAX_START_SPEED, 0.0, -MAX_START_SPEED)
            theta, omega, *goal = self.np_random.uniform(low, high).tolist()
            self._theta, self._omega, self._goal = theta, omega, (goal[0], goal[1])
            self._step = 0
            return observe(theta, omega, 0, self._goal), {}

        def step(self, action: int):
            torque = TORQUES[action]
            self._theta, self._omega = step_state(self._theta, self._omega, torque)
            self._step += 1
            reward = -TORQUE_WEIGHT * torque**2 * DT
            finished = self._step == NUM_STEPS
            if finished:
                reward += terminal_reward(self._theta, self._omega, self._goal)
            seen = observe(self._theta, self._omega, self._step, self._goal)
            return seen, reward, finished, False, {}

    return PendulumEnvironment()


def make_learner(
    num_environments: int, steps_per_update: int, batch_size: int, num_epochs: int, seed: int
) -> Any:
    """Return Stable-Baselines3's PPO on the pendulum, on the CPU."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.logger import Logger
    from stable_baselines3.common.vec_env import DummyVecEnv
    from torch.nn import Tanh

    learner = PPO(
        "MlpPolicy",
        DummyVecEnv([make_environment] * num_environments),
        n_steps=steps_per_update,
        batch_size=batch_size,
        n_epochs=num_epochs,
        gamma=1.0,
        ent_coef=1.0 / BETA,
        policy_kwargs={"net_arch": {"pi": [64, 64], "vf": [64, 64]}, "activation_fn": Tanh},
        seed=seed,
        device="cpu",
    )
    learner.set_logger(Logger(folder=None, output_formats=[]))  # the default one leaves a folder
    return learner


def measure(
    num_steps: int = 20_000,
    num_environments: int = 8,
    steps_per_update: int = NUM_STEPS,
    batch_size: int = 64,
    num_epochs: int = 10,
    num_rollout_environments: int = 100,
    num_rollouts: int = 1_000,
    num_threads: int = 1,
    seed: int = 0,
) -> dict[str, float]:
    """Measure training and sampling speed, each after a warm-up.

    Args:
      num_steps: training is measured over at least this many environment steps.
      num_environments: environments that training steps one after the other.
      steps_per_update: steps of each environment between two updates.
      batch_size: states in a minibatch; 64 and 10 epochs are the library's defaults.
      num_epochs: passes over the steps in an update.
      num_rollout_environments: environments that sampling steps one after the other.
      num_rollouts: episodes sampled, rounded up to a multiple of those environments.
      num_threads: threads that torch may use.
      seed: seed of the networks, tasks and actions.
    Returns:
      For `training` and for `rollout` (which only predicts): `_steps` measured over,
      `_steps_per_second` by the clock and `_steps_per_processor_second` of all threads together;
      and `milliseconds_per_rollout` by the clock.
    Raises:
      ModuleNotFoundError: if gymnasium, torch or stable_baselines3 is not installed.
    """
    check_installed()
    import torch

    torch.set_num_threads(num_threads)
    learner = make_learner(num_environments, steps_per_update, batch_size, num_epochs, seed)
    waves = -(-num_rollouts // num_rollout_environments)
    training = _measure_training(learner, num_steps)
    rollout = _measure_rollouts(learner, num_rollout_environments, waves, seed)
    return {
        "training_steps": training.steps,
        "training_steps_per_second": training.steps / training.seconds,
        "training_steps_per_processor_second": training.steps / training.processor_seconds,
        "rollout_steps": rollout.steps,
        "rollout_steps_per_second": rollout.steps / rollout.seconds,
        "rollout_steps_per_processor_second": rollout.steps / rollout.processor_seconds,
        "milliseconds_per_rollout": 1e3 * NUM_STEPS * rollout.seconds / rollout.steps,
    }


@dataclass
class _Timing:
    """Environment steps, and the seconds they took by the clock and by the processor."""

    steps: int = 0
    seconds: float = 0.0
    processor_seconds: float = 0.0


@contextmanager
def _timed() -> Iterator[_Timing]:
    """Yield a timing that the block fills with steps, and its end with seconds."""
    timing = _Timing()
    clock, processor = time.perf_counter(), time.process_time()
    yield timing
    timing.seconds = time.perf_counter() - clock
    timing.processor_seconds = time.process_time() - processor


def _measure_training(learner: Any, num_steps: int) -> _Timing:
    """Time `num_steps` steps of training or a little more, after one update as a warm-up."""
    learner.learn(learner.n_steps * learner.n_envs)
    warm_up = learner.num_timesteps
    with _timed() as timing:
        learner.learn(num_steps, reset_num_timesteps=False)
        timing.steps = learner.num_timesteps - warm_up
    return timing


def _measure_rollouts(learner: Any, num_environments: int, waves: int, seed: int) -> _Timing:
    """Time `waves` episodes of every environment, after one as a warm-up."""
    from stable_baselines3.common.vec_env import DummyVecEnv

    environments = DummyVecEnv([make_environment] * num_environments)
    environments.seed(seed)
    seen = environments.reset()

    def sample(num_steps: int) -> int:
        nonlocal seen
        for _ in range(num_steps):
            actions, _ = learner.predict(seen, deterministic=False)
            seen, *_ = environments.step(actions)
        return num_steps * num_environments

    sample(NUM_STEPS)
    with _timed() as timing:
        timing.steps = sample(waves * NUM_STEPS)
    return timing


def print_table(result: dict[str, float]) -> None:
    """Print the figures and the load of the machine."""
    table = Table(title="Stable-Baselines3 PPO, pendulum")
    table.add_column("")
    for column in ("steps", "steps / s", "steps / processor s"):
        table.add_column(column, justify="right")
    for job in ("training", "rollout"):
        figures = ("steps", "steps_per_second", "steps_per_processor_second")
        table.add_row(job, *(f"{result[f'{job}_{figure}']:,.0f}" for figure in figures))
    console = Console()
    console.print(table)
    console.print(
        f"{result['milliseconds_per_rollout']:.2f} ms a rollout of {NUM_STEPS} steps; "
        f"{os.cpu_count()} cores, load average {os.getloadavg()[0]:.1f}"
    )


def main() -> None:
    """Measure with the settings given on the command line and print a table."""
    parser = argparse.ArgumentParser(description="Speed of Stable-Baselines3 PPO on Swerve's job.")
    parser.add_argument("--num-steps", type=int, default=20_000)
    parser.add_argument("--steps-per-update", type=int, default=NUM_STEPS)
    parser.add_argument("--batch-size", type=int, default=64)
    parser.add_argument("--num-epochs", type=int, default=10)
    parser.add_argument("--num-rollouts", type=int, default=1_000)
    parser.add_argument("--num-threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    try:
        print_table(measure(**vars(parser.parse_args())))
    except ModuleNotFoundError as error:
        raise SystemExit(str(error)) from None


if __name__ == "__main__":
    main()
