"""Decode Parquet files in a process of its own: run as a script by `parquet_format`.

A request is a line of JSON on the standard input, then the content of a file:

    {"size": bytes of the content, "numbers": [names], "label": name or null}

Its answer is a line of JSON on the standard output, then the numbers, column by column, as float64:

    {"found": [names], "types": {name: type}, "nulls": {name: row}, "names": [names], "rows": count,
     "labels": [texts]},   or   {"error": text}

The process ends when its input ends, and where a file takes too much memory or makes polars panic:
what is left of such a file would stand in the way of the next one.

`types` are those of wanted columns that cannot be read, `nulls` the first row, counted from 0, of
wanted columns in which the value is missing.
"""

import contextlib
import io
import json
import resource
import signal
import sys
from typing import Any

SECONDS = 60  # processor time for one file: more means that the file is made to take long
MEMORY = 2**31  # bytes of address space beside those in proportion to the file
TIMES = 32  # bytes of address space for each byte of the file: compressed numbers grow by less


def main() -> None:
    """Answer requests until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks
    import polars as pl

    source, sink = sys.stdin.buffer, sys.stdout.buffer
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for line in iter(source.readline, b""):
        request = json.loads(line)
        content = source.read(request["size"])
        _limit(len(content))
        try:
            answer, numbers = _read(pl, content, request["numbers"], request["label"])
        except pl.exceptions.PolarsError as error:
            answer, numbers = {"error": f"{type(error).__name__}: {error}"}, b""
        sink.write(json.dumps(answer).encode() + b"\n" + numbers)
        sink.flush()


def _limit(size: int) -> None:
    """Limit the time and memory for a file of `size` bytes; beyond the limits the process ends."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    end = int(used.ru_utime + used.ru_stime) + SECONDS
    for kind, limit in ((resource.RLIMIT_CPU, end), (resource.RLIMIT_AS, MEMORY + TIMES * size)):
        most = resource.getrlimit(kind)[1]
        if most == resource.RLIM_INFINITY or limit < most:
            with contextlib.suppress(ValueError, OSError):  # macOS has no limit of memory
                resource.setrlimit(kind, (limit, most))


def _read(pl: Any, content: bytes, wanted: list[str], label: str | None) -> tuple[Any, bytes]:
    """Return the answer to a request, and the numbers."""
    schema = pl.read_parquet_schema(io.BytesIO(content))
    names = [name for name in dict.fromkeys(wanted) if name in schema]
    read = names if label is None or label not in schema else [label, *names]
    answer = {"found": list(schema), "types": {}, "nulls": {}, "names": [], "rows": 0, "labels": []}
    for name in read:
        kind = schema[name]
        is_read = kind.is_numeric()
        if name == label:
            is_read = kind.is_integer() or kind in (pl.String, pl.Categorical, pl.Enum)
        if not is_read:
            answer["types"][name] = str(kind)
    if answer["types"] or not read:
        return answer, b""
    frame = pl.read_parquet(io.BytesIO(content), columns=read)
    for name in read:
        if frame[name].null_count():
            answer["nulls"][name] = int(frame[name].is_null().arg_true()[0])
    if label in read and label not in answer["nulls"]:
        answer["labels"] = frame[label].cast(pl.String).to_list()
    columns = (frame[name].cast(pl.Float64).fill_null(float("nan")) for name in names)
    numbers = b"".join(column.to_numpy().tobytes() for column in columns)
    return answer | {"names": names, "rows": frame.height}, numbers


if __name__ == "__main__":
    sys.path.extend(sys.argv[1:])
    main()
