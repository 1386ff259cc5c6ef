"""What each correction of finished motions brings: every type by many seeds, finished with all, and without each.

Prints a table in Markdown: the mean and the worst roll-out, and the share of frames in which the limit of acceleration
holds the root. `raw` is the roll-out as the network and its frame corrections make it. Seeds are for choosing settings;
docs/scoreboard.md has others.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from unittest.mock import patch

import numpy as np

from motionkit.arrays import Array
from motionkit.control.follow import follow_path
from motionkit.control.path import shape_path
from motionkit.control.script import parse_types
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.errors import MotionkitError
from motionkit.finish import feet, finish, root_height
from motionkit.finish.finish import Unfinished
from motionkit.lab.scoreboard.smoothness import AT_LIMIT
from motionkit.metrics.flight import flights
from motionkit.metrics.ground import foot_skate_ratio, sliding_over_ground
from motionkit.metrics.leaps import leaps
from motionkit.metrics.pace import ground_acceleration
from motionkit.metrics.touch import hover_share, touching
from motionkit.models.bundled import load_bundled_model
from motionkit.motion.floor import foot_positions
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import Motion

SECONDS = 4.0  # of types that are not performances
STANDING = 2.2  # cm; the floor that skating toes are measured above
PATHS = (("circle", "walking"), ("square", "running"), ("figure-eight", "running,cartwheel,running"))
COLUMNS = ("sliding", "skate", "hover", "lowest", "acceleration", "free fall", "leaps", "at limit")
WORST: dict[str, Callable[[Array], float]] = {"lowest": np.min}


def drawn(first: int, count: int, paths: bool) -> Iterator[Unfinished]:
    """Roll-outs of all types, or along paths, before they are finished."""
    model = load_bundled_model()
    if paths:
        for shape, types in PATHS:
            for seed in range(first, first + count):
                path = shape_path(shape, 3.0, types.split(","), None)
                made = follow_path(model, path, SynthesisOptions(seed=seed)).unfinished
                assert made is not None
                yield made
        return
    for kind in model.types:
        parts = parse_types(kind if model.phase_seconds(kind) else f"{kind}:{SECONDS:g}")
        for one in synthesize(model, parts, SynthesisOptions(count, first)).motions:
            assert one.unfinished is not None
            yield one.unfinished


def without(name: str) -> Callable[[Unfinished], Motion]:
    """How a motion is finished without one of the corrections."""

    def made(one: Unfinished) -> Motion:
        if name == "root locked to feet":
            return replace(one, settings=replace(one.settings, hold=0.0)).finished()
        if name == "soles on the floor":
            return replace(one, settings=replace(one.settings, soles=None)).finished()
        if name == "limit of acceleration":
            return replace(one, settings=replace(one.settings, most=None)).finished()
        place, function, instead = {
            "feet in range": (finish, "ankles_in_range", lambda motion: motion),
            "out of the ground": (finish, "above_ground", lambda motion: motion),
            "foot locking": (finish, "lock_feet", lambda motion, contacts: motion),
            "hips that come down": (
                feet,
                "hip_drop",
                lambda motion, positions, shifts: np.zeros((len(motion), 3)),
            ),
            "floating bodies come down": (
                root_height,
                "_floating",
                lambda positions: np.zeros(len(positions)),
            ),
            "toes above the ground": (finish, "clear_toes", lambda motion, *heights: motion),
            "free fall": (root_height, "_free_fall", lambda positions, fps, size: np.zeros(len(positions))),
        }[name]
        with patch.object(place, function, instead):
            return one.finished()

    return made


WAYS: dict[str, Callable[[Unfinished], Motion]] = {
    "raw": lambda one: one.motion,
    "all": Unfinished.finished,
    **{
        f"without {name}": without(name)
        for name in (
            "feet in range",
            "out of the ground",
            "root locked to feet",
            "limit of acceleration",
            "foot locking",
            "hips that come down",
            "floating bodies come down",
            "free fall",
            "soles on the floor",
            "toes above the ground",
        )
    },
}


def measured(motion: Motion, most: float | None) -> tuple[float, ...]:
    """The columns of one motion."""
    positions = motion_kinematics(motion)[1]
    soles = foot_positions(positions)
    try:
        skate = foot_skate_ratio(soles, STANDING).value
    except MotionkitError:  # no toe stands
        skate = 0.0
    acceleration = ground_acceleration(motion.root_positions, motion.fps)
    errors = [abs(flight.error) for flight in flights(positions, ~touching(positions))]
    return (
        sliding_over_ground(soles).value or 0.0,
        skate or 0.0,
        hover_share(positions).value or 0.0,
        float(positions[..., 1].min()),
        float(acceleration.max(initial=0.0)),
        max(errors, default=0.0),
        leaps(positions).value or 0.0,
        0.0 if most is None else float((acceleration > AT_LIMIT * most).mean()),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=20, help="seeds of each type, or of each path")
    parser.add_argument("--paths", action="store_true", help="along paths instead of types")
    asked = parser.parse_args()
    made = list(drawn(asked.first, asked.count, asked.paths))
    print(f"{len(made)} roll-outs\n\n| finished | {' | '.join(COLUMNS)} |\n|---|{'---|' * len(COLUMNS)}")
    for name, way in WAYS.items():
        rows = np.array([measured(way(one), one.settings.most) for one in made])
        cells = [
            f"{rows[:, n].mean():.4f}, {WORST.get(column, np.max)(rows[:, n]):.3g}"
            for n, column in enumerate(COLUMNS)
        ]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
