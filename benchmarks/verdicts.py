"""How often the verdict on a type is right, where the truth is known because it was made.

    python benchmarks/verdicts.py DATASET [--model FILE] [--unlearnt FILE] [--json FILE]

A type works if what was made are recordings of it that the judge's limits were not taken from. It does not work if they
are recordings of another type, or spoilt ones of its own: limbs held halfway to the mean pose, half or twice the speed,
a frozen pose that moves on. Limits come from three quarters of the recordings and judge up to eight of the last quarter
as if they were roll-outs, four times. Settings are chosen on the first two of these folds; the table has the last two.
--model adds roll-outs of a model that works, --unlearnt those of one that does not.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from common import print_table

from motionkit.data.dataset import Dataset
from motionkit.metrics.body import Body, body_of
from motionkit.models.checkpoint import load_model
from motionkit.motion.motion import Motion
from motionkit.motion.rotations import quat_normalize
from motionkit.training.verdict.judge import GRACE, Judge
from motionkit.training.verdict.real import RealMotion, Stretch
from motionkit.training.verdict.types import TypeVerdict, quick_verdicts, verdict_on

FOLDS = 4
OTHERS, ROLL_OUTS = 2, 8  # other types, and recordings of them; recordings of a type that are judged together
WORKS = ("recordings of the type", "roll-outs of a model that works")
LONGEST = 8.0  # seconds of a recording that are judged


def at_rate(body: Body, factor: float) -> Body:
    """The body, moving so many times as fast."""
    at = np.clip(np.round(np.arange(0, len(body) - 1, factor)).astype(int), 0, len(body) - 1)
    return Body(body.rotations[at], body.positions[at], body.heading[at], body.fps)


def halfway(body: Body, skeleton) -> Body:
    """The body with limbs held halfway to their mean pose."""
    turns = body.rotations.copy()
    limbs = turns[:, 1:]
    mean = quat_normalize(
        np.where((limbs * limbs[:1]).sum(-1, keepdims=True) < 0, -limbs, limbs).mean(axis=0)
    )
    sign = np.where((limbs * mean).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    turns[:, 1:] = quat_normalize(limbs * sign + mean)
    return body_of(Motion(skeleton, turns.astype(np.float32), body.positions[:, 0], body.fps))


def frozen(body: Body, skeleton) -> Body:
    """The body in its first pose, moved on."""
    turns = np.repeat(body.rotations[:1], len(body), axis=0)
    turns[:, 0] = body.rotations[:, 0]
    return body_of(Motion(skeleton, turns, body.positions[:, 0], body.fps))


SPOILT: dict[str, Callable[[Body, object], Body]] = {
    "limbs halfway to the mean pose": halfway,
    "half the speed": lambda body, _: at_rate(body, 0.5),
    "twice the speed": lambda body, _: at_rate(body, 2.0),
    "frozen, root moves on": frozen,
}


def after_a_command(body: Body) -> Body:
    """The body as the judge expects it, which leaves out the first GRACE seconds."""
    first = round(GRACE * body.fps)
    parts = (
        np.concatenate([np.repeat(x[:1], first, axis=0), x[: round(LONGEST * body.fps)]])
        for x in (body.rotations, body.positions, body.heading)
    )
    return Body(*parts, body.fps)


def folds_of(dataset: Dataset) -> Iterator[tuple[Judge, list[Stretch]]]:
    """Judges without a share of the recordings, and that share."""
    whole = RealMotion(dataset)
    sources = {c: dataset.clips[c].name for c in {s.clip for s in whole.stretches}}
    places: dict[int, int] = {}
    for kind in whole.types:
        for place, clip in enumerate(sorted({s.clip for s in whole.of_type(kind)} - set(places))):
            places[clip] = place % FOLDS
    for fold in range(FOLDS):
        out = {sources[clip] for clip, place in places.items() if place == fold}
        left = copy(dataset)
        left.clips = tuple(replace(c, split="train") for c in dataset.clips if c.name not in out)
        yield (
            Judge(RealMotion(left), by_recordings=True),
            [s for s in whole.stretches if sources[s.clip] in out],
        )


def recorded_cases(dataset: Dataset) -> Iterator[tuple[int, str, TypeVerdict]]:
    """The fold, what was judged, and the verdict."""
    random = np.random.default_rng(0)
    for fold, (judge, held) in enumerate(folds_of(dataset)):
        by_type: dict[str, list[Stretch]] = defaultdict(list)
        for stretch in held:
            by_type[stretch.type].append(stretch)
        kinds = [kind for kind in judge.real.types if judge.real.profile(kind) is not None]
        for kind in kinds:
            mine = by_type[kind][:ROLL_OUTS]
            bodies = [after_a_command(s.body) for s in mine]
            if mine:
                yield fold, "recordings of the type", verdict_on(judge, kind, bodies)
            for name, spoil in SPOILT.items() if mine else ():
                made = [spoil(s.body, dataset.skeleton(dataset.clips[s.clip])) for s in mine]
                yield (
                    fold,
                    name,
                    verdict_on(judge, kind, [after_a_command(body) for body in made]),
                )
            others = [other for other in by_type if other != kind and by_type[other]]
            for other in random.choice(others, min(OTHERS, len(others)), replace=False):
                bodies = [after_a_command(s.body) for s in by_type[other][:OTHERS]]
                yield fold, f"recordings of another type: {other}", verdict_on(judge, kind, bodies)


def rolled_cases(dataset: Dataset, path: Path | None, what: str) -> Iterator[tuple[int, str, TypeVerdict]]:
    """The same of the roll-outs of a model."""
    if path is not None:
        for verdict in quick_verdicts(load_model(path), Judge(RealMotion(dataset))):
            yield FOLDS - 1, what, verdict


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--model", type=Path)
    parser.add_argument("--unlearnt", type=Path)
    parser.add_argument("--json", type=Path, help="also write every verdict here")
    arguments = parser.parse_args()
    dataset, cases = Dataset(arguments.dataset), []
    ways = (
        recorded_cases(dataset),
        rolled_cases(dataset, arguments.model, WORKS[1]),
        rolled_cases(dataset, arguments.unlearnt, "roll-outs of one that does not"),
    )
    for fold, what, verdict in itertools.chain(*ways):
        cases.append((fold, what, verdict))
        print(fold, what, verdict.sentence(), flush=True, file=sys.stderr)
        if arguments.json:
            rows = [{"fold": f, "what": w, **asdict(v)} for f, w, v in cases]
            arguments.json.write_text(json.dumps(rows), encoding="utf-8")
    table: dict[str, Counter] = defaultdict(Counter)
    for fold, what, verdict in cases:
        if fold >= FOLDS // 2:
            several = verdict.rollouts > 1
            for group in (
                what.partition(":")[0],
                "all",
                *(["all of two or more recordings"] if several else []),
            ):
                table[group]["works" if verdict.works else "fails"] += 1
                table[group]["right"] += verdict.works == (what in WORKS)
    rows = [
        (name, str(n["works"]), str(n["fails"]), f"{n['right'] / (n['works'] + n['fails']):.2f}")
        for name, n in table.items()
    ]
    print_table("Verdicts on types", ("what was judged", "works", "does not work", "right"), rows)


if __name__ == "__main__":
    main()
