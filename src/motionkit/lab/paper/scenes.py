"""What the paper's figures 1 and 5 to 9 show, made by a model: motion types in sequence, and characters on paths.

The paper gives its paths as pictures alone; those here have their shapes and types, in sizes that suit the recordings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from motionkit.control.follow import follow_path
from motionkit.control.path import METRE, PathPart, make_path, shape_path
from motionkit.control.script import TypePart
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.errors import MotionkitError
from motionkit.lab.statistics import rounded
from motionkit.models.model import MotionModel
from motionkit.view.figure_data import MotionView

WALK_SECONDS = 2.0  # of gaits in a sequence; other types last one performance
DANCE_SECONDS = 8.0

# Points in metres, x to the left and z ahead, and a type.
PathSection = tuple[str, Sequence[tuple[float, float]]]


@dataclass(frozen=True)
class Scene:
    """What a figure shows.

    Attributes:
        types: motion types and seconds (None: one performance) in sequence, where there is no path.
        sections: stretches of a path, each with its type.
        shape: a named shape in place of ways, with its size in metres and its types.
        paper: the paper's distance from the path, cm per frame.
    """

    figure: str
    name: str
    text: str
    types: tuple[tuple[str, float | None], ...] = ()
    sections: tuple[PathSection, ...] = ()
    shape: tuple[str, float, tuple[str, ...]] | None = None
    paper: float | None = None


def _waves(length: float, height: float, count: float, start: float, end: float) -> list[tuple[float, float]]:
    """Points between two shares of a sine wave of a length and height in metres."""
    along = np.linspace(start, end, 60)
    across = height * (1.0 - np.cos(2.0 * math.pi * count * along)) / 2.0
    return list(zip(across.tolist(), (length * along).tolist(), strict=True))


def _curved(kinds: Sequence[str], ends: Sequence[float]) -> tuple[PathSection, ...]:
    """One gentle curve of 15 m whose stretches end at these shares of it."""
    starts = (0.0, *ends)
    return tuple(
        (kind, _waves(15.0, 3.0, 1.0, a, b)) for kind, a, b in zip(kinds, starts, ends, strict=False)
    )


SCENES: tuple[Scene, ...] = (
    Scene("1", "heterogeneous", "running, twist, side somersault, whirlwind kick, cartwheel",
          (("running", WALK_SECONDS), ("twist", None), ("side-somersault", None), ("w-kicking", None),
           ("cartwheel", None))),
    Scene("5a", "flips", "side somersaults and cartwheels without a pause",
          (("side-somersault", None), ("side-somersault", None), ("cartwheel", None), ("cartwheel", None))),
    Scene("5b", "dance-female", "a dance", (("dance-indian", DANCE_SECONDS),)),
    Scene("5c", "dance-male", "a dance", (("dance-modern", DANCE_SECONDS),)),
    Scene("6", "curves", "walking a path with large curvatures",
          sections=(("walking", _waves(9.0, 2.4, 3.0, 0.0, 1.0)),), paper=0.513),
    Scene("7a", "same-path-1", "running, side somersault, cartwheel, running",
          sections=_curved(("running", "side-somersault", "cartwheel", "running"), (0.35, 0.5, 0.7, 1.0)), paper=1.988),
    Scene("7b", "same-path-2", "the same path: running, whirlwind kick, side somersault, running",
          sections=_curved(("running", "w-kicking", "side-somersault", "running"), (0.35, 0.5, 0.7, 1.0)), paper=1.749),
    Scene("8", "complex", "jumping right, left, running, jumping left, right",
          sections=tuple((kind, _waves(16.0, 2.5, 2.0, i / 5, (i + 1) / 5)) for i, kind in enumerate(
              ("jumping-r", "jumping-l", "running", "jumping-l", "jumping-r"))), paper=0.454),
    Scene("9a", "pentagram-corner", "running around a corner of a pentagram",
          sections=(("running", ((0.0, 0.0), (0.0, 6.0))), ("running", ((6.0 * math.sin(math.radians(144.0)),
                6.0 + 6.0 * math.cos(math.radians(144.0))),)))),
    Scene("9b", "u-turn", "a U-turn, walking and jumping left", shape=("u-turn", 7.0, ("walking", "jumping-l"))),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Made:
    """A scene as a model made it: what to show; on paths the distance (cm per frame), and whether the end was met."""

    scene: Scene
    view: MotionView
    distance: float | None = None
    finished: bool = True


def chosen_scenes(names: Sequence[str]) -> list[Scene]:
    """Return the scenes of names or figure numbers, all for none. Raises MotionkitError if one is unknown."""
    for name in names:
        if not any(name in (each.name, each.figure) for each in SCENES):
            known = ", ".join(f"{each.name} ({each.figure})" for each in SCENES)
            raise MotionkitError(f"unknown scene {name!r}, expected one of {known}")
    return [each for each in SCENES if not names or each.name in names or each.figure in names]


def picture_name(figure: str, name: str) -> str:
    """Return the file name of a scene's picture beside docs/experiments.md; docs/make_scenes.py makes some of them."""
    return f"figure-{figure}-{name}.png"


def make_scene(model: MotionModel, scene: Scene, seed: int) -> Made:
    """Make a scene with a model; feet are not held, as in the paper's figures.

    Raises:
        ControlError: if the model lacks a type.
    """
    options = SynthesisOptions(seed=seed, ik=False)
    title = f"figure {scene.figure}: {scene.text}"
    if scene.types:
        parts = [
            TypePart(kind, seconds or model.phase_seconds(kind) or WALK_SECONDS)
            for kind, seconds in scene.types
        ]
        made = synthesize(model, parts, options).motions[0]
        return Made(scene, MotionView(title, made.motion, [(p.type, p.seconds) for p in made.types]))
    if scene.shape is not None:
        name, size, kinds = scene.shape
        path = shape_path(name, size, list(kinds), None)
    else:
        path = make_path([PathPart(np.array(points) * METRE, kind) for kind, points in scene.sections])
    found = follow_path(model, path, options)
    bands = [(part.type, part.seconds) for part in found.types]
    return Made(
        scene, MotionView(title, found.motion, bands, path.points), found.distance.mean, found.finished
    )


def scene_facts(made: Sequence[Made]) -> dict[str, Any]:
    """Return what several seeds made of one scene, as plain values for a results file."""
    scene = made[0].scene
    distances = [each.distance for each in made if each.distance is not None]
    return {
        "figure": scene.figure,
        "name": scene.name,
        "text": scene.text,
        "seconds": [round(each.view.motion.seconds, 2) for each in made],
        "distances": [rounded(d) for d in distances],
        "finished": sum(each.finished for each in made),
        "paper": scene.paper,
    }
