"""Each option has a test of its effect, and a bad value of it is refused in one line."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import pytest
from support.command import Run

from swerve.cli import app as cli

TESTS = Path(__file__).parents[1]
EFFECTS = "cli/test_option_effects"
JUDGING = f"{EFFECTS}::TestJudging"
LEARNING = f"{EFFECTS}::TestLearningAndSampling"
WATCH = f"{EFFECTS}::TestWatch"
JUDGED = ("--prior-none", "--tolerance", "--margin", "--clearance")
SAMPLED = ("--constraint", "--out", "--num", "--solver", "--seed")
CONTROLLED = ("--by", "--max-action", "--num-steps", "--goal-tolerance")
HOW = ("--solver", "--samples", "--method", "--seed", "--work")
TESTED: dict[str, dict[str, str]] = {  # the test that looks at what an option does, by command
    "infer": {
        **dict.fromkeys(HOW, f"{LEARNING}::test_infer"),
        "--tasks": f"{JUDGING}::test_tasks",
        "--score": f"{JUDGING}::test_score",
        "--prior-none": f"{JUDGING}::test_prior_none",
        "--tolerance": f"{JUDGING}::test_tolerance",
        "--margin": f"{JUDGING}::test_margin",
        "--clearance": f"{JUDGING}::test_clearance",
        "--report": f"{JUDGING}::test_report",
        "--json": f"{JUDGING}::test_json",
        "--no-resolve": "sampling/test_resolve::test_the_command_leaves_bounds_where_it_is_told_to",
        "--resolve-seconds": (
            "sampling/test_resolve_budget::test_the_command_says_what_is_left_and_goes_on"
        ),
        "--greedy": "cli/test_infer::test_several_constraints_one_after_another",
        "--threshold": "cli/test_infer::test_several_constraints_one_after_another",
    },
    "fit-beta": {
        **dict.fromkeys((*HOW, "--tasks", "--confidence", "--json"), f"{LEARNING}::test_fit_beta")
    },
    "watch": {
        **dict.fromkeys(HOW, f"{WATCH}::test_learning_and_sampling"),
        "--tasks": f"{WATCH}::test_tasks",
        **dict.fromkeys(JUDGED, f"{WATCH}::test_judging"),
    },
    "learn": dict.fromkeys(("--work", "--solver", "--seed"), f"{LEARNING}::test_learn"),
    "sample": dict.fromkeys((*HOW, "--tasks", "--json"), f"{LEARNING}::test_sample"),
    "demo": dict.fromkeys(("--work", "--report"), f"{EFFECTS}::test_demo"),
    "demonstrate": {
        **dict.fromkeys(SAMPLED, "cli/test_demonstrate_options::test_boltzmann"),
        "--tasks": "cli/test_demonstrate::test_demonstrate_with_tasks_of_ones_own",
        **dict.fromkeys(CONTROLLED, "cli/test_demonstrate_options::test_optimal_control"),
    },
    "reproduce": {
        "--out": "reproduce/test_gridworld::test_command",
        "--quick": "reproduce/test_gridworld::test_command",
        "--data": "reproduce/test_gridworld::test_command",
        "--seed": "cli/test_reproduce::test_the_seed_is_that_of_the_result",
        "--json": "reproduce/test_human_walk::test_the_command_prints_json",
    },
}


def options_of(command: str) -> dict[str, Any]:
    """Return the types of a command's options by name, as the library of the command line says."""
    parameters = cli.app[command].assemble_argument_collection(
        default_parameter=cli.app.default_parameter
    )
    return {
        argument.name: argument.hint
        for argument in parameters
        if argument.name.startswith("--") and argument.parse
    }


COMMANDS = [name for name in cli.app if not name.startswith("-")]
OPTIONS = [(command, option) for command in COMMANDS for option in options_of(command)]


def test_each_option_has_a_test_of_its_effect() -> None:
    """A new option fails here until the table names a test that uses it."""
    table = [(command, option) for command in TESTED for option in TESTED[command]]
    assert sorted(table) == sorted(OPTIONS)


def text_of(place: str) -> str:
    """Return the code of a test, with the fixtures, helpers and constants of its file it names."""
    file, *names = place.split("::")
    tree: Any = ast.parse((TESTS / f"{file}.py").read_text())
    body = tree
    for name in names:
        (body,) = [node for node in body.body if getattr(node, "name", None) == name]
    found, rest = [body], list(tree.body)
    while used := [node for node in rest if any(defined(node) & named(one) for one in found)]:
        found += used
        rest = [node for node in rest if node not in found]
    return "\n".join(map(ast.unparse, found))


def defined(node: ast.stmt) -> set[str]:
    """Return the names that a function or an assignment of a file defines."""
    if isinstance(node, ast.FunctionDef):
        return {node.name}
    targets = node.targets if isinstance(node, ast.Assign) else []
    return {one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)}


def named(body: ast.AST) -> set[str]:
    """Return the names and the arguments in a piece of code: those of a test are fixtures."""
    nodes = list(ast.walk(body))
    arguments = {node.arg for node in nodes if isinstance(node, ast.arg)}
    return arguments | {node.id for node in nodes if isinstance(node, ast.Name)}


@pytest.mark.parametrize(("command", "option"), OPTIONS, ids=" ".join)
def test_the_test_is_there_and_names_the_option(command: str, option: str) -> None:
    """In the function itself, or in what it uses of its file."""
    assert re.search(rf"{option}(?![\w-])", text_of(TESTED[command][option]))


def test_what_a_test_does_not_use_does_not_count() -> None:
    """Such as a constant of its file."""
    assert "--solver" in text_of(f"{LEARNING}::test_infer")
    assert "--solver" not in text_of(f"{JUDGING}::test_json")


WORDS = {  # the least of each command, to which a bad value is added
    "infer": ["infer", "pendulum"],
    "fit-beta": ["fit-beta", "pendulum", "x.csv"],
    "watch": ["watch", "pendulum", "--work", "w"],
    "learn": ["learn", "pendulum", "--work", "w"],
    "sample": ["sample", "pendulum", "--work", "w"],
    "demo": ["demo"],
    "demonstrate": ["demonstrate", "pendulum", "--constraint", "3", "--out", "out"],
    "reproduce": ["reproduce", "gridworld", "--out", "out"],
}
NO_NUMBERS = ["nan", "-inf", "1e999", "1_0", "0x10", "\u0663", "x", "", " ", "1.5.0"]
BAD = {  # values that no option of a type may have
    int: [*NO_NUMBERS, "inf", "1.5"],
    float: NO_NUMBERS,
    str: ["", " ", "\t"],
    Path: ["", " ", "a\0b"],
    bool: ["maybe", ""],
    dict: [*NO_NUMBERS, "inf"],
}
OUT_OF_RANGE = {  # values of the right type, by the names of their options
    "--samples": ["-1", "0", "1", "1e15", "99999999999999999999"],
    "--seed": ["-1", "4294967296", "99999999999999999999"],
    "--method": ["magic"],
    "--solver": ["magic", "?", "grid?num_points", "grid?x=1&x=2"],
    "--prior-none": ["-0.1", "1.1", "1e300"],
    "--tolerance": ["-0.1", "0.6", "1e300"],
    "--margin": ["-1", "1e300"],
    "--clearance": ["-1"],
    "--greedy": ["-1", "0"],
    "--resolve-seconds": ["-1", "0"],
    "--confidence": ["-1", "0", "1", "95"],
    "--constraint": ["-1", "100", "99999999999999999999"],
    "--num": ["-1", "0", "99999999999999999999"],
    "--score": ["best", ""],
    "--by": ["magic", ""],
    "--report": [".", "x.txt"],
    "--data": ["missing"],
    "--tasks": ["missing.csv", "."],
}
NEEDS = {  # what an option goes with
    "--max-action": ["--by", "optimal-control"],
    "--num-steps": ["--by", "optimal-control"],
    "--goal-tolerance": ["--by", "optimal-control"],
    "--threshold": ["--greedy", "1", "x.csv"],
    "--greedy": ["x.csv"],
}
OUT_OF_RANGE |= {name: ["-1", "0"] for name in ("--max-action", "--num-steps", "--goal-tolerance")}
OUT_OF_RANGE["--threshold"] = ["-1"]


def kind_of(hint: Any) -> type:
    """Return the type of an option's value, of those that BAD knows."""
    text = str(hint)
    named = [kind for kind in (dict, bool, int, float, Path) if kind.__name__ in text]
    return named[0] if named else str


@pytest.mark.parametrize(("command", "option"), OPTIONS, ids=" ".join)
def test_a_bad_value_ends_in_one_line_and_writes_nothing(
    command: str,
    option: str,
    run: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.csv").write_text("theta,omega\n1,0\n1,0.1\n")
    kind = kind_of(options_of(command)[option])
    values = [*BAD[kind], *OUT_OF_RANGE.get(option, [])]
    name = f"{option}.theta" if option == "--margin" else option
    words = WORDS[command]
    if option in words:
        place = words.index(option)
        words = [*words[:place], *words[place + 2 :]]
    for value in values:
        given = [f"{name}={value}"] if kind is bool else [name, value]
        status, out, said = run(*words, *NEEDS.get(option, []), *given)
        assert status in (1, 2), (value, said)
        assert out == "", value
        assert said.startswith("swerve: error: "), (value, said)
        assert said.count("\n") == 1, (value, said)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["x.csv"], value


@pytest.mark.parametrize("words", [["infer", ""], ["infer", "pendulum", ""], ["learn", " "]])
def test_an_empty_problem_or_file_is_refused(words: list[str], run: Run) -> None:
    status, _, said = run(*words, *(["--work", "w"] if words[0] == "learn" else []))
    assert status == 2
    assert said.startswith("swerve: error: expected a ")
    assert said.count("\n") == 1


def test_a_margin_without_a_state_says_how_it_is_given(run: Run) -> None:
    status, _, said = run("infer", "pendulum", "--margin", "0.1")
    assert status == 2
    assert "expected a state and its margin, as in --margin.x 0.05, got '0.1' alone" in said


def test_wrong_words_end_in_one_line(run: Run) -> None:
    for words, message in (
        (["nix"], 'Unknown command "nix"'),
        (["infer"], "PROBLEM requires an argument"),
        (["infer", "pendulum", "--nix"], "Unknown option: --nix; see --help"),
        (["infer", "pendulum", "--seed"], "--seed requires an argument"),
    ):
        status, out, said = run(*words)
        assert (status, out) == (2, "")
        assert message in said
        assert said.count("\n") == 1
