from __future__ import annotations

import json
from pathlib import Path


def test_keys_of_a_file(motionkit, tmp_path: Path) -> None:
    (tmp_path / "keys.json").write_text(
        json.dumps({"keys": [{"time": 1, "position": [0.2, 1.2], "facing": 15}]})
    )
    said = motionkit("synthesize", "--types", "walking:1.5", "--keys", "keys.json", "-o", "a.bvh")
    assert said.code == 0 and "key at 1 s: 0.00 cm and 0.0 degrees away" in said.out
    value = json.loads(motionkit("synthesize", "--types", "walking:1.5", "--keys", "keys.json", "--json").out)
    assert value["motions"][0]["keys"][0]["cm"] < 2.0
    before = sorted(tmp_path.iterdir())
    assert motionkit("synthesize", "--types", "walking:0.5", "--keys", "keys.json").failed_with(
        "a key at 1 s"
    )
    assert motionkit("synthesize", "--types", "walking", "--keys", "keys.json", "--loop").code == 2
    assert motionkit("synthesize", "--types", "walking", "--keys", "keys.json", "--in-place").code == 2
    (tmp_path / "bad.json").write_text("{")
    assert motionkit("synthesize", "--types", "walking", "--keys", "bad.json").failed_with(
        "bad.json: not JSON"
    )
    assert sorted(path for path in tmp_path.iterdir() if path.name != "bad.json") == before


def test_the_clip_of_a_key_is_not_overwritten(motionkit, tmp_path: Path) -> None:
    assert motionkit("synthesize", "--types", "walking:1", "-o", "pose.bvh").code == 0
    before = (tmp_path / "pose.bvh").read_bytes()
    (tmp_path / "keys.json").write_text(
        json.dumps({"keys": [{"time": 1, "pose": {"file": "pose.bvh", "seconds": 0.5}}]})
    )
    words = "synthesize", "--types", "walking:1.5", "--keys", "keys.json", "-o", "pose.bvh"
    said = motionkit(*words)
    assert said.code == 2 and "pose.bvh: is read by this command" in said.err
    assert (tmp_path / "pose.bvh").read_bytes() == before
