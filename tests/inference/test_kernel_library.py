"""The compiled step as a file that may be damaged, and as code that refuses what it cannot run.

What goes wrong here ends a process without a word, so all of it happens in one of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import motionkit
from motionkit.inference import step_kernel
from motionkit.native import LIBRARY_ENDING

SOURCE = Path(motionkit.__file__).parents[1]


def run(script: str, *words: object, optimized: bool = False) -> dict:
    """What a script prints as JSON at its end."""
    command = [sys.executable, *(["-O"] if optimized else []), "-c", script, *map(str, words)]
    path = os.pathsep.join([str(SOURCE), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=100, env=os.environ | {"PYTHONPATH": path}
    )
    assert done.returncode == 0, f"exit {done.returncode}: {done.stderr[-2000:]}"
    return json.loads(done.stdout.splitlines()[-1])


LOAD = """
import json, sys
from pathlib import Path
from motionkit.inference.step_kernel import VERSION
from motionkit.errors import MotionkitError
from motionkit.native import load_library
found = {}
for p in sorted(Path(sys.argv[1]).iterdir()):
    try:
        load_library(p / "lib", "step_kernel_version", VERSION + (p.name == "version"))
        found[p.name] = ""
    except MotionkitError as error:
        found[p.name] = str(error)
print(json.dumps(found))
"""


def test_a_damaged_library_is_one_line(tmp_path: Path) -> None:
    built = Path(step_kernel.__file__).parent
    data = (built / f"_step_kernel{LIBRARY_ENDING}").read_bytes()
    cuts = {
        f"cut-{share}": data[: int(share * len(data))] for share in (0.0, 0.001, 0.1, 0.3, 0.6, 0.9, 0.999)
    }
    zeros = {
        "zeros": bytes(len(data)),
        "zero-tail": data[: len(data) // 2] + bytes(len(data) - len(data) // 2),
    }
    others = {"text": b"#!/bin/sh\n" * 99, "other-machine": data[:18] + b"\xff\xff" + data[20:]}
    whole = {"version": data, "whole": data}
    for name, content in (cuts | zeros | others | whole).items():
        (tmp_path / name).mkdir()
        (tmp_path / name / f"lib{LIBRARY_ENDING}").write_bytes(content)
    found = run(LOAD, tmp_path)
    assert [name for name, fault in found.items() if not fault] == ["whole"]
    assert "is of another version" in found.pop("version")
    assert all("is damaged" in fault for fault in found.values() if fault)
    assert len(found) == 12


REFUSE = """
import ctypes, json
from ctypes import byref
from motionkit.errors import ModelError
from motionkit.models.config import ModelConfig
from motionkit.inference.step_kernel import _SIZES, _Frame, _Program, kernel_library

refused = {}
for window in (18, 1000):
    try:
        ModelConfig(window=window)
    except ModelError:
        refused[f"config of window {window}"] = True
library, nowhere = kernel_library(), ctypes.create_string_buffer(1 << 20)
good = dict(parts=2, layers=2, width=48, hidden=96, heads=4, window=8, kernel=3, part_inputs=100, controls=50,
            control_width=24, control_blocks=2, contact_hidden=64, features=276, contacts=4)
for change in ({"window": 33}, {"window": 100_000}, {"window": 0}, {"heads": 0}, {"heads": 5}, {"contacts": 33},
               {"layers": 2**40}, {"width": -48}, {"control_blocks": 3}):
    program = _Program(*((good | change)[name] for name in _SIZES), 0.9, -5.0, 2.0, 1e-5)
    size = library.scratch_size(byref(program), 1)
    refused[f"{change}"] = size < 0 and library.step(byref(program), byref(_Frame()), 0, 1, nowhere) != 0
program = _Program(*good.values(), 0.9, -5.0, 2.0, 1e-5)
assert library.scratch_size(byref(program), 1) > 0
for slot in (-1, 8):
    frame = _Frame(slot=slot)
    refused[f"slot {slot}"] = library.step(byref(program), byref(frame), 0, 1, nowhere) != 0
print(json.dumps(refused))
"""


def test_sizes_beyond_its_stack_are_refused_without_asserts() -> None:
    refused = run(REFUSE, optimized=True)
    assert len(refused) == 13 and all(refused.values())
