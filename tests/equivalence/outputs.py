"""SHA-256 of what commands write and print: two checkouts that should behave the same print the same lines.

`python tests/equivalence/outputs.py [FILE...]` runs fixed commands on the sample of the repository, and retargets each
FILE besides. Digests depend on the machine: compare checkouts on one machine only.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from safetensors.numpy import load_file

ROOT = Path(__file__).resolve().parents[2]
SAMPLE, KEYS = ROOT / "examples" / "data", Path(__file__).with_name("keys.json")

COMMANDS = (
    "synthesize --types running:3,cartwheel:3 --seed 1 -o types.bvh",
    "synthesize --types walking:2,kicking:2 --count 3 --seed 2 --no-ik -o crowd.csv",
    f"synthesize --types idle:4 --keys {KEYS} --seed 3 -o keys.bvh",
    "synthesize --types dance-salsa --loop --seconds 4 --seed 4 -o cycle.glb",
    "follow-path figure-eight --types walking --seed 5 -o eight.bvh",
    "follow-path circle --types running,cartwheel,b-walking --seed 6 --root ground -o circle.usda",
    f"synthesize --types backflip --seed 7 --rig {SAMPLE}/90_02.bvh -o rig.bvh",
    f"retarget {SAMPLE}/49_06.bvh --rig {SAMPLE}/16_45.bvh -o retargeted.bvh",
    f"retarget {SAMPLE}/35_01.bvh -o canonical.bvh",
    f"mirror {SAMPLE}/127_03.bvh -o mirrored.bvh",
    f"loop {SAMPLE}/35_01.bvh -o loop.bvh",
    f"fix {SAMPLE}/90_02.bvh -o fixed.bvh",
    "convert types.bvh types.vrma",
    f"metrics {SAMPLE}/16_57.bvh types.bvh --json",
    f"doctor {SAMPLE} --json",
    f"preprocess {SAMPLE} -o dataset --jobs 1",
    "train dataset --from-scratch --preset tiny --steps 20 --splices 20 --seed 1 -o tiny.safetensors",
)


def main() -> None:
    """Run the commands and print a digest for each file and for each output on the terminal."""
    extra = [f"retarget {Path(file).resolve()} -o foreign-{n}.bvh" for n, file in enumerate(sys.argv[1:])]
    environment = os.environ | {"MOTIONKIT_THREADS": "1", "OMP_NUM_THREADS": "1", "COLUMNS": "100"}
    with tempfile.TemporaryDirectory() as folder:
        for command in (*COMMANDS, *extra):
            before = {path for path in Path(folder).rglob("*") if path.is_file()}
            done = subprocess.run(
                [sys.executable, "-m", "motionkit", *command.split()],
                cwd=folder, capture_output=True, env=environment,
            )  # fmt: skip
            shown = command.split()[0] not in (
                "synthesize",
                "preprocess",
                "train",
            )  # these say how long they took
            printed = digest(done.stdout.replace(str(ROOT).encode(), b"")) if shown else "-"
            print(done.returncode, printed, command.replace(str(ROOT), ""))
            for path in sorted(Path(folder).rglob("*")):
                if path.is_file() and path not in before:
                    print("   ", digest(content(path)), path.relative_to(folder))


def content(path: Path) -> bytes:
    """The bytes of a file; of models and training logs without the seconds they took."""
    if path.suffix == ".safetensors":
        return b"".join(name.encode() + array.tobytes() for name, array in sorted(load_file(path).items()))
    if path.suffix == ".jsonl":
        rows = [json.loads(line) for line in path.read_text().splitlines()]
        return json.dumps([row | {"seconds": 0} for row in rows]).encode()
    return path.read_bytes()


def digest(data: bytes) -> str:
    """The first 16 letters of a SHA-256."""
    return hashlib.sha256(data).hexdigest()[:16]


if __name__ == "__main__":
    main()
