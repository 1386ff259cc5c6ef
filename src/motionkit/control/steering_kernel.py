"""Loads steering_kernel.c, the steering of live characters and their places on paths."""

from __future__ import annotations

import ctypes
from ctypes import Structure, c_double, c_int32, c_void_p
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

from motionkit.native import load_library

VERSION = 2  # of steering_kernel.c


@cache
def doubles(record: type) -> Any:
    """The struct of a dataclass whose fields are numbers."""
    return type(
        record.__name__, (Structure,), {"_fields_": [(field.name, c_double) for field in fields(record)]}
    )


class Part(Structure):
    """A part of a path."""

    _fields_ = (
        *((name, c_double) for name in "requested lateral seconds end facing".split()),
        *((name, c_int32) for name in "type last".split()),
    )


@cache
def steering_library() -> ctypes.CDLL:
    """Return the shared library. Raises MotionkitError if this installation has none of this version."""
    path = Path(__file__).resolve().parent / "_steering_kernel"
    library = load_library(path, "steering_kernel_version", VERSION)
    wish = [c_double, c_double, c_double]  # x, z, facing or heading
    for name, arguments, result in (
        ("observe", [c_void_p, *wish, c_int32], None),
        ("spring_speed", [c_void_p], c_double),
        ("steered_type", [c_void_p, *wish], c_int32),
        ("steer", [c_void_p, c_int32, *wish], c_double),
        ("path_points", [c_void_p, c_int32], c_int32),
        ("even_points", [c_void_p, c_void_p, c_int32, c_int32, c_void_p, c_void_p, c_void_p], None),
        ("part_speed", [c_void_p, c_void_p, c_int32, c_double], c_double),
        ("plan_path", [c_void_p, c_void_p], None),
        ("follow", [c_void_p, *wish], c_double),
        ("path_weights", [c_void_p, c_double, c_double, c_void_p], None),
    ):
        function = getattr(library, name)
        function.argtypes, function.restype = arguments, result
    return library
