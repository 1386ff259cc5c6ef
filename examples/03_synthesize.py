"""Synthesize motion types one after another, with the bundled model or your own.

python examples/03_synthesize.py --types running:2,cartwheel:3 -o out.bvh
"""

from __future__ import annotations

import argparse
from pathlib import Path

import motionkit as mk


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--types", default="running:2,cartwheel:3", help="types, optionally with seconds")
    parser.add_argument("--model", type=Path, help="a model file; the bundled model by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=Path("out.bvh"))
    arguments = parser.parse_args()

    model = mk.load_model(arguments.model)
    print(f"types of the model: {', '.join(model.types)}")
    result = mk.synthesize(arguments.types, model=model, seed=arguments.seed)
    motion = result.motion
    mk.write_bvh(arguments.output, motion)
    print(f"wrote {arguments.output}: {motion.seconds:.1f} s, made in {result.seconds:.2f} s")
    for row in mk.measure(motion).rows:
        if row.motion.value is not None:
            print(f"  {row.id} {row.motion.value:.3g} {row.motion.unit}")


if __name__ == "__main__":
    main()
