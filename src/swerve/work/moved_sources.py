"""Name the source files of Swerve that the move into packages changed without changing a result.

A work folder of an editable installation records hashes of Swerve's own MDPs. A folder from before
the move is still used as long as these files are as the move left them.
"""

AS_MOVED = {  # hash of a file before the move: its hash after it
    # mdp.py, now problem/mdp.py
    "d5a9b27ff6281958f03ee732f4b7d91eba93368e2743544fa051440518ab5731": (
        "d037853c0eded24d2196a02dc2d3785ee4558e53656fc79ecf3fe03f22740ac4"
    ),
    # systems/car.py
    "5200f7aea0998c7f5641cf47483f3563d156de5bf9ea1166d1f44a0ff5af6861": (
        "a98b9775c335257e5e20989370e2b054e8eae614e4c12a2c50c041f1e2facd91"
    ),
    # systems/double_pendulum.py
    "52e99a76c8f7e31a17ed79bb2d74d8ca396c5d5ba7746c34c5fa7b7da8102180": (
        "77954726b3921b3804b6a2c75c9da0f0d6a2de4c2ff80e67af2dfc1180cc4318"
    ),
    # systems/gridworld.py
    "7af92bbb8c55b13b313df84e8d5c63ddb0c54b863a09754773a77df1068210ff": (
        "10664adfe1b4041ebf5a4691d6ecf65d6a98204e1fcf3f8aeb62485e6aa03300"
    ),
    # systems/pendulum.py
    "d0687a6d372f7c3c7ae24fb53d73cefa8d41689444c058ef7cfde66148cda6bf": (
        "da0a83ec4c47c67705dccf6930680d75033d8d4b16d4182f095c4e0037378987"
    ),
    # systems/tabular.py
    "fdc28d7435090f38301d829d104767c6014eef281fc72360c15096aef2b9733f": (
        "27150119c7518303a9b508eadb93dfbd4d8b80833547f0a9adb8918c4a6bb937"
    ),
    # systems/walker.py
    "66573e3f97c8c67a48e94997917356aa27cc197f8b2b59e8a330ab5e2721084c": (
        "c430c73382ac76e868915895eafb12e34824764a110cd9b510882e14d79aaa38"
    ),
}
