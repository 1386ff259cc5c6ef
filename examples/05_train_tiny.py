"""Train a tiny model on BVH files in a minute, to show every step.

python examples/05_train_tiny.py examples/data --minutes 1 -o tiny.safetensors

It learns little; motionkit train with its default preset and an hour learns more.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import motionkit as mk

if TYPE_CHECKING:
    from motionkit.training.report import TrainEvent


def show(event: TrainEvent) -> None:
    """Print losses and notes of the run."""
    if event.kind == "log":
        losses = ", ".join(f"{name} {value:.2f}" for name, value in event.losses.items())
        print(f"step {event.step}: {losses}")
    elif event.kind == "note":
        print(event.text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="BVH files, with a labels.csv or in folders named by type")
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--steps", type=int, help="stop after this many steps, if that is earlier")
    parser.add_argument("-o", "--output", type=Path, default=Path("tiny.safetensors"))
    arguments = parser.parse_args()

    dataset = arguments.output.with_suffix(".dataset")
    report = mk.preprocess([arguments.folder], dataset, mk.PreprocessOptions(jobs=1))
    print(f"{report.clips} clips, {report.seconds:.0f} s of motion: {', '.join(report.types)}")

    options = mk.train_options(
        "tiny",
        minutes=arguments.minutes,
        steps=arguments.steps,
        batch=8,
        window=64,
        splices=50,
        score_seconds=0.0,  # no roll-out scores
    )
    mk.train(dataset, arguments.output, options, device="cpu", on_event=show)

    model = mk.load_model(arguments.output)
    kind = model.type_names[0]
    motion = mk.synthesize(f"{kind}:2", model=model).motion
    mk.write_bvh(arguments.output.with_suffix(".bvh"), motion)
    print(f"wrote {arguments.output} and {arguments.output.with_suffix('.bvh')} ({kind})")


if __name__ == "__main__":
    main()
