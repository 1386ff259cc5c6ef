"""What results say and must have; reads those that commands write for one model: long roll-outs, bodies, scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from motionkit.data.dataset import Dataset
from motionkit.errors import MotionkitError
from motionkit.files import read_json, safe_name
from motionkit.lab.paper.bodies import MEASURES
from motionkit.lab.paper.datasets import SELECTIONS
from motionkit.lab.paper.scenes import SCENES
from motionkit.lab.paper.variants import GROUPS, VARIANTS
from motionkit.version import __version__

Results = list[dict[str, Any]]
SHIPPED_GROUP = "shipped"  # of results that are no variant's

# What a field holds: a class (float takes whole numbers too, only bool takes true), [shape] for a list of them,
# {name: shape} for an object with at least these fields, {...: shape} for one with any names, (shape, None) for a value
# that may be null.
LARGEST = 1e20  # number in a result, so that sums and squares stay finite
Shape = Any
NUMBER_OR_NULL = (float, None)
MEANS: Shape = {...: [NUMBER_OR_NULL]}  # metric to [made, recorded]
RESULT: Shape = {
    "name": str,
    "group": str,
    "seed": int,
    "data": str,
    "made": {"training": str, "test": str, "version": str},
    "longest": int,
    "parameters": int,
    "groups": {"all": MEANS},
    "distribution": {"fid-pose": NUMBER_OR_NULL, "diversity": NUMBER_OR_NULL, "diversity-gt": NUMBER_OR_NULL},
    "sequences": [{"sequence": str, "frames": int, "values": MEANS}],
}
OF_NETWORKS: Shape = {
    "budget": {"name": str, "steps": int, "batch": int, "window": int, "rate": float},
    "curve": [[float]],
    "derivatives": {...: float},
    "timing": {"seconds": float, "machine": str},
}
ERRORS: Shape = {...: NUMBER_OR_NULL}
HELD_OUT: Shape = {
    "frames": int,
    "error": ERRORS,
    "copy": ERRORS,
    "extrapolation": ERRORS,
    "starts": int,
    "open-loop": {"mean": ERRORS, "sample": ERRORS},
    "bm": ERRORS,
}
# Of one model, which the page is written from.
MODEL: Shape = {"model": str, "steps": (int, None)}
LONG: Shape = {
    "rollouts": [
        {
            **{
                "type": str,
                "seed": int,
                "holds": bool,
                "distance": [float],
                "swing": [float],
                "speed": [float],
            },
            **{f"{name}-recorded": float for name in ("distance", "swing", "speed")},
            "speed-fastest": float,
        }
    ]
}
BODIES: Shape = {
    "type": str,
    "seeds": int,
    "performers": [{"performer": str, **dict.fromkeys(("recorded", "made"), dict.fromkeys(MEASURES, float))}],
}
OF_SCENES: Shape = {
    "scenes": [
        {**dict.fromkeys(("figure", "name", "text"), str), "distances": [float], "finished": int}
        | {"paper": NUMBER_OR_NULL}
    ]
}
WORDS = {
    dict: "an object",
    list: "a list",
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
}


def made_from(dataset: Dataset) -> dict[str, str]:
    """Return what a result says that it was made from: digests of training and test clips, and our version."""
    return {"training": dataset.digest("train"), "test": dataset.digest("test"), "version": __version__}


def check_result(result: Any) -> None:
    """Check that the result of a run has all that tables and figures take from it.

    Raises:
        MotionkitError: a field is missing or of another type, or the names of experiment and data set are unknown.
    """
    _check(result, RESULT, "")
    name, group, data = result["name"], result["group"], result["data"]
    if data not in SELECTIONS and data != safe_name(data):
        raise MotionkitError(
            f"the data set {data!r:.40}, expected one of {', '.join(SELECTIONS)}, or a plain name"
        )
    if group != SHIPPED_GROUP:
        known = {each.name: each for each in VARIANTS}
        if name not in known:
            raise MotionkitError(
                f"the experiment {name!r:.40}, which `motionkit experiment list` does not have"
            )
        if group not in GROUPS:
            raise MotionkitError(f"the group {group!r:.40}, expected one of {', '.join(GROUPS)}")
        if known[name].preset:
            _check(result, OF_NETWORKS, "")
            if result["derivatives"]:  # of networks that predict a trajectory
                _check(result["derivatives"], {"trajectory": float, "features": float}, "derivatives")
    for field, shape in (("text", str), ("held-out", HELD_OUT), ("by-mean", {"all": MEANS})):
        if field in result:  # floors have not all of them
            _check(result[field], shape, field)
    for part, values in result["groups"].items():
        _check(values, MEANS, f"groups.{part}")
    groups = [*result["groups"].values(), *result.get("by-mean", {}).values()]
    pairs = [*groups, *(row["values"] for row in result["sequences"])]
    if any(len(pair) != 2 for values in pairs for pair in values.values()):
        raise MotionkitError("a metric without its two values, made and recorded")
    if any(len(point) != 2 for point in result.get("curve", [])):
        raise MotionkitError("a point of the curve without step and loss")


def _check(value: Any, shape: Shape, where: str) -> None:
    """Raise MotionkitError that names the first field of another type."""
    if isinstance(shape, tuple):
        if value is None:
            return
        shape = shape[0]
    plain = dict if isinstance(shape, dict) else list if isinstance(shape, list) else shape
    expected: Any = (int, float) if plain is float else plain
    if not isinstance(value, expected) or isinstance(value, bool) != (plain is bool):
        raise MotionkitError(f"{where or 'the whole'} is {value!r:.40}, expected {WORDS[plain]}")
    if isinstance(value, (int, float)) and abs(value) > LARGEST:
        raise MotionkitError(f"{where} is {value!r:.40}, expected at most {LARGEST:g}")
    if isinstance(shape, dict):
        for key, one in shape.items():
            if key is not ... and key not in value:
                raise MotionkitError(f"{where + '.' if where else ''}{key} is missing")
            for name in value if key is ... else [key]:
                _check(value[name], one, f"{where}.{name}" if where else name)
    if isinstance(shape, list):
        for number, each in enumerate(value):
            _check(each, shape[0], f"{where}[{number}]")


# What commands write for one model into the folder of the same name: in words, and what it has.
OF_ONE_MODEL: dict[str, tuple[str, Shape]] = {
    "scenes": ("all scenes", OF_SCENES),
    "long": ("long roll-outs", LONG),
    "bodies": ("bodies", BODIES),
}


def read_models(folder: Path, kind: str) -> Results:
    """Return the results of one of OF_ONE_MODEL of all models in a folder, the shipped model's first.

    Raises:
        MotionkitError: a file lacks something that the page takes from it.
    """
    what, shape = OF_ONE_MODEL[kind]
    out = []
    known = [(scene.figure, scene.name) for scene in SCENES]
    for path in sorted(folder.glob("*.json"), key=lambda p: (p.stem != "shipped", p.stem)):
        result = read_json(path, f"the results of {what}", MotionkitError)
        try:
            _check(result, MODEL | shape, "")
            if safe_name(result["model"]) != result["model"]:  # pictures beside the page are named after it
                raise MotionkitError(f"model is {result['model']!r:.40}, expected a name of files")
            if not all(result[key] for key in shape if isinstance(shape[key], list)):
                raise MotionkitError(f"{', '.join(shape)} is empty")
            # Pictures are named after them too.
            if "scenes" in shape and [(each["figure"], each["name"]) for each in result["scenes"]] != known:
                raise MotionkitError("scenes are missing, or others")
        except MotionkitError as error:
            raise MotionkitError(f"{path}: not the results of {what} ({error}); make them again") from None
        out.append(result)
    return out
