"""Helpers of the benchmarks: timing, a plain table, a line about the machine."""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

SAMPLE_FOLDER = Path(__file__).resolve().parent.parent / "examples" / "data"


def time_calls(function: Callable[[], object], repeats: int, warm_up: int = 1) -> list[float]:
    """Return the seconds of each repeat, after some warm-up calls."""
    for _ in range(warm_up):
        function()
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - began)
    return seconds


def time_in_turn(functions: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Return the median seconds of each function; they run in turn, so that slow phases of the machine affect all."""
    for function in functions:
        function()
    rounds = [[time_calls(function, 1, 0)[0] for function in functions] for _ in range(repeats)]
    return [statistics.median(column) for column in zip(*rounds, strict=True)]


def percentiles(seconds: Sequence[float]) -> tuple[float, float, float]:
    """Return the 50th, 95th and 99th percentile."""
    p50, p95, p99 = np.percentile(seconds, [50, 95, 99])
    return float(p50), float(p95), float(p99)


def machine_line() -> str:
    """Return processor, cores and versions, for a line below every table."""
    return (
        f"{processor_name()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}, numpy {np.__version__}"
    )


def processor_name() -> str:
    """Return the processor's name, if the system gives it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table, with the first column aligned left, and the machine below it."""
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    print(title)
    for row in (header, *rows):
        cells = [row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]
        print("  " + "  ".join(cells).rstrip())
    print(machine_line())
