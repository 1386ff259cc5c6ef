"""Motion types one after another, from the bundled model or your own.

python examples/03_synthesize.py --types running:2,cartwheel:3 -o out.bvh
"""

from __future__ import annotations

import argparse
from pathlib import Path

from motionkit.control.script import parse_types
from motionkit.control.synthesize import SynthesisOptions, synthesize
from motionkit.inference.rollout import Noise
from motionkit.metrics.report import evaluate_motion
from motionkit.models.bundled import open_model
from motionkit.motion.bvh import write_bvh


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--types", default="running:2,cartwheel:3", help="types, with seconds if wanted")
    parser.add_argument("--model", type=Path, help="a model file; the bundled model by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=Path("out.bvh"))
    arguments = parser.parse_args()

    model = open_model(arguments.model)
    print(f"the model knows {', '.join(model.types)}")
    options = SynthesisOptions(seed=arguments.seed, noise=Noise("correlated", temperature=0.3), ik=True)
    parts = parse_types(arguments.types, usual=model.phase_seconds)
    result = synthesize(model, parts, options)
    motion = result.motions[0].motion
    write_bvh(arguments.output, motion)
    print(f"wrote {arguments.output}: {motion.seconds:.1f} s, made in {result.seconds:.2f} s")
    for row in evaluate_motion(motion).rows:
        if row.motion.value is not None:
            print(f"  {row.id} {row.motion.value:.3g} {row.motion.unit}")


if __name__ == "__main__":
    main()
