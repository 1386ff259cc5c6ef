"""Every variant and baseline runs for a few steps and gives a result; the same seed gives the same figures."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.data.options import PreprocessOptions
from motionkit.data.preprocess import preprocess
from motionkit.errors import DatasetError, MotionkitError
from motionkit.lab.held_out import held_out
from motionkit.lab.paper import rollout_sheets, runs
from motionkit.lab.paper.datasets import SELECTIONS, Selection, is_dance, select
from motionkit.lab.paper.kept_rollouts import rollouts_file
from motionkit.lab.paper.model_results import made_from
from motionkit.lab.paper.protocol import METRICS
from motionkit.lab.paper.runs import Plan, is_done, measure_again, read_results, result_file, run_one
from motionkit.lab.paper.shipped import features_after, run_shipped
from motionkit.lab.paper.tables import tables
from motionkit.lab.paper.variants import GROUPS, VARIANTS, Variant, chosen, parameters, variant
from motionkit.models.bundled import BUNDLED, open_model
from motionkit.motion.bvh import write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.training.presets import train_options
from synthetic_motions import make_cartwheel, make_dance, make_idle, make_jump, make_walk

pytestmark = pytest.mark.thorough

# Fields that make networks small; what a variant changes stays.
SMALL: dict[str, dict[str, Any]] = {
    "tptn-paper": {
        "width": 48, "heads": 4, "ffn": 96, "layers": 1, "control_width": 16, "control_embedding": 16,
        "shared_channels": 12,
    },
    "pfnn": {"hidden": 16},
    "mvae": {"hidden": 16, "gate": 8, "latent": 4, "experts": 2},
    "htss": {"part": 4, "limb": 8, "body": 16, "decoder": 8},
    "neural-layering": {"hidden": 16, "gate": 8, "experts": 2},
    "learned-motion-matching": {"hidden": 16, "latent": 4},
}  # fmt: skip


@pytest.fixture
def plan(paper_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plan:
    """A plan of 20 small steps on all sequences."""

    def small(plan: Plan, each: Variant, seed: int):
        sizes = SMALL[each.preset] | {k: v for k, v in each.config.items() if k not in SMALL[each.preset]}
        changes = {"batch": 2, "window": 16, "precision": "float32", "score_seconds": 0.0, "log_every": 5}
        return train_options(
            each.preset, steps=plan.steps, config=sizes, seed=seed, **changes, **each.options
        )

    monkeypatch.setattr(runs, "options_of", small)
    folders = {"results": tmp_path / "results", "checkpoints": tmp_path / "checkpoints"}
    return Plan(paper_folder, "all", steps=20, longest=30, device="cpu", **folders)


def run(plan: Plan, each: Variant, seed: int = 0) -> dict[str, Any]:
    return json.loads(run_one(plan, each, seed, lambda text: None, lambda share: None).read_text())


# One of each kind in the default run, all of them with -m slow.
QUICK = ("TPTN", "CrossAttn", "MVAE", "last frame", "motion matching")
SMOKE = [pytest.param(v, id=v.name, marks=() if v.name in QUICK else pytest.mark.slow) for v in VARIANTS]


@pytest.mark.parametrize("each", SMOKE)
def test_every_variant_runs(plan: Plan, each: Variant) -> None:
    result = run(plan, each)
    assert result["name"] == each.name and result["group"] in GROUPS
    everything = result["groups"]["all"]
    assert {*METRICS, "bm-upper", "bm-lower", "class-accuracy", "l2p", "l2q", "npss"} == set(everything)
    assert all(
        value is not None for metric in ("bm-euler", "mpjpe", "ssim-channel") for value in everything[metric]
    )
    sets = {"fid-pose", "diversity", "diversity-gt", "class-accuracy", "fid-class"}
    assert result["sequences"] and set(result["distribution"]) == sets
    if each.preset:
        assert result["budget"]["steps"] == 20 and result["parameters"] > 0 and len(result["curve"]) == 4
    assert ("derivatives" in result) == ("held-out" in result) == ("by-mean" in result) == bool(each.preset)
    if each.preset:
        assert ("nll" in result["held-out"]) == (each.group != "baselines" and each.name != "L2 Loss")
        assert result["by-mean"]["all"]["bm-euler"][1] == everything["bm-euler"][1]


def test_finished_runs_are_measured_again_from_their_roll_outs(plan: Plan) -> None:
    each = variant("MVAE")
    result = run(plan, each)
    file = result_file(plan, each, 0)
    # A run whose metrics are still to come, and one of before a metric was thought of.
    for missing in ("groups", "by-mean"):
        file.write_text(json.dumps({key: value for key, value in result.items() if key != missing}))
        assert list(measure_again(plan.data, plan.results)) == [file]
        assert json.loads(file.read_text()) == result
    kept = rollouts_file(file)
    made = kept.read_bytes()
    for damaged, complaint in (
        (made[:200], "not the roll-outs of an experiment"),
        (b"", "not the roll-outs"),
    ):
        kept.write_bytes(damaged)
        with pytest.raises(MotionkitError, match=rf"mvae-0\.npz: {complaint}"):
            list(measure_again(plan.data, plan.results))
    kept.write_bytes(made)
    file.write_text(json.dumps(result | {"longest": 60}))
    with pytest.raises(MotionkitError, match=r"mvae-0\.npz: the roll-outs of other sequences"):
        list(measure_again(plan.data, plan.results))
    file.write_text(json.dumps(result | {"made": result["made"] | {"test": "x"}}))
    with pytest.raises(MotionkitError, match=r"mvae-0\.json: made from other test clips"):
        list(measure_again(plan.data, plan.results))


def test_sheets_show_what_networks_made_below_the_recorded(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("MVAE", "TPTN"):
        run(plan, variant(name))
    tested = read_results(plan.results)[0]["sequences"][0]["type"]
    monkeypatch.setattr(rollout_sheets, "KINDS", {"10": tested, "11": "a type that is not tested"})
    drawn: list[tuple[str, Any]] = []
    monkeypatch.setattr(rollout_sheets, "write_contact_sheet", lambda path, rows, poses: drawn.extend(rows))
    (path,) = rollout_sheets.write_sheets(plan.data, plan.results, tmp_path)
    assert path.name == f"figure-10-{tested}.png"
    assert [name for name, _ in drawn] == ["recorded", "TPTN", "MVAE"]
    motions = [motion for _, motion in drawn]
    assert len({len(motion) for motion in motions}) == 1
    first = [motion_kinematics(motion)[1][0] for motion in motions]
    assert 0.0 < max(np.abs(each - first[0]).max() for each in first[1:]) < 100.0  # cm, after one frame


def test_untrained_contacts_are_not_fed_back() -> None:
    assert [each.name for each in VARIANTS if not each.learns_contacts] == ["w/o-F"]


def test_the_same_seed_gives_the_same_figures(plan: Plan, tmp_path: Path) -> None:
    each = variant("MVAE")
    again = replace(plan, results=tmp_path / "again", checkpoints=tmp_path / "again-checkpoints")
    one, two, other = run(plan, each), run(again, each), run(plan, each, seed=1)
    for result in (one, two, other):
        del result["timing"]
    assert one == two
    assert one["groups"] != other["groups"]


def test_what_is_done_is_skipped_and_what_was_stopped_continues(plan: Plan) -> None:
    each = variant("MVAE")
    stopped = replace(plan, steps=10)
    first = run(stopped, each)
    file = result_file(stopped, each, 0)
    stamp = file.stat().st_mtime_ns
    assert run(stopped, each) == first and file.stat().st_mtime_ns == stamp
    # The checkpoint of the shorter run stands where the longer one looks for its own.
    source, target = (p.checkpoints / p.folder for p in (stopped, plan))
    target.parent.mkdir(parents=True, exist_ok=True)
    source.rename(target)
    assert run(plan, each)["budget"]["steps"] == 20
    log = (target / "mvae-0.run" / "log.jsonl").read_text()
    assert [json.loads(line)["step"] for line in log.splitlines() if '"log"' in line] == [5, 10, 15, 20]


def test_results_are_read_back_and_broken_ones_named(plan: Plan) -> None:
    run(plan, variant("last frame"))
    (read,) = read_results(plan.results)
    assert read["folder"] == "all/cpu-20" and read["name"] == "last frame"
    (plan.results / "all" / "cpu-20" / "odd.json").write_text("{")
    with pytest.raises(MotionkitError, match=r"odd\.json: not the result of an experiment"):
        read_results(plan.results)


def test_a_result_says_what_it_was_made_from(plan: Plan, labelled_folder: Path) -> None:
    each = variant("last frame")
    result = run(plan, each)
    made = made_from(select(plan.data, plan.selection))
    assert result["made"] == made and made["training"] != made["test"]
    assert is_done(plan, each, 0, made) and not is_done(plan, each, 1, made)
    longer = replace(plan, longest=60)
    with pytest.raises(MotionkitError, match=r"last-frame-0\.json: made with --frames 30, not 60"):
        is_done(longer, each, 0, made)
    elsewhere = replace(plan, data=labelled_folder)
    with pytest.raises(MotionkitError, match=r"last-frame-0\.json: made from other training and test clips"):
        run(elsewhere, each)
    # Other test clips of the same training clips.
    dataset = select(plan.data, plan.selection)
    dataset.clips = dataset.clips[:-1]
    other = made_from(dataset)
    assert other["training"] == made["training"]
    with pytest.raises(MotionkitError, match="made from other test clips"):
        is_done(plan, each, 0, other)
    file = result_file(plan, each, 0)
    trained = run(plan, variant("MVAE"))
    before = {key: value for key, value in trained["budget"].items() if key != "method"}
    result_file(plan, variant("MVAE"), 0).write_text(json.dumps(trained | {"budget": before}))
    with pytest.raises(MotionkitError, match=r"mvae-0\.json: made with another method of training"):
        is_done(plan, variant("MVAE"), 0, made)
    file.write_text("")
    with pytest.raises(MotionkitError, match=r"last-frame-0\.json: .*delete it and run it again"):
        run(plan, each)


def test_the_committed_results_are_read() -> None:
    folder = Path(__file__).resolve().parents[3] / "experiments" / "results"
    assert len(read_results(folder)) == len(list(folder.rglob("*.json"))) > 0


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"groups": None}, "groups is None, expected an object"),
        ({"groups": {}}, "groups.all is missing"),
        ({"groups": {"all": {"afs": [1.0, "2"]}}}, r"groups.all.afs\[1\] is '2', expected a number"),
        ({"groups": {"all": {"afs": [1.0]}}}, "a metric without its two values"),
        ({"data": "D/X"}, "the data set 'D/X', expected one of D_L, all"),
        ({"name": "nobody"}, "the experiment 'nobody'"),
        ({"group": "odd"}, "the group 'odd', expected one of tptn"),
        ({"longest": "240"}, "longest is '240', expected a whole number"),
        ({"longest": True}, "longest is True, expected a whole number"),
        ({"timing": {"seconds": "60", "machine": "CPU"}}, "timing.seconds is '60', expected a number"),
        ({"curve": [[1]]}, "a point of the curve"),
        ({"derivatives": {"trajectory": 1.0}}, "derivatives.features is missing"),
        ({"made": {"training": "x", "version": "1"}}, "made.test is missing"),
        ({"held-out": {"frames": 1}}, "held-out.error is missing"),
        ({"by-mean": {"all": {"afs": [1.0]}}}, "a metric without its two values"),
        *(({field: ...}, f"{field} is missing") for field in ("group", "data", "longest", "timing", "budget")),
    ],
)  # fmt: skip
def test_a_fault_in_a_result_is_named(change: dict[str, Any], complaint: str, tmp_path: Path) -> None:
    committed = (
        Path(__file__).resolve().parents[3] / "experiments" / "results" / "D_L" / "long-520" / "tptn-0.json"
    )
    result = json.loads(committed.read_text("utf-8")) | change
    (tmp_path / "odd.json").write_text(json.dumps({k: v for k, v in result.items() if v is not ...}))
    with pytest.raises(MotionkitError, match=rf"odd\.json: not the result of an experiment \({complaint}"):
        read_results(tmp_path)


# ---- the tables of variants and data sets ----


def test_names_groups_and_all() -> None:
    assert [v.name for v in chosen(("fusion", "TPTN"))] == ["TPTN", "w/o-FFL", "CrossAttn", "w/o-CL"]
    assert [v.name for v in chosen(("tptn",)) if v.runs_at("cpu")] == ["TPTN"]
    assert len(chosen(("all",))) == len(VARIANTS) == len({v.name for v in VARIANTS})
    assert chosen(("W/O-ffl",))[0].name == "w/o-FFL"
    with pytest.raises(MotionkitError, match="unknown experiment 'nobody'"):
        chosen(("nobody",))


def test_an_architecture_of_an_entry_point_is_an_experiment(tmp_path: Path) -> None:
    package = tmp_path / "mine-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text(
        "[motionkit.architectures]\nmine = motionkit.lab.networks.mvae:MotionVae\n"
    )
    told = "from motionkit.lab.paper.variants import *; print(VARIANTS[-4].name, parameters(variant('mine')))"
    places = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, "-c", told], env=os.environ | {"PYTHONPATH": places}, capture_output=True, text=True
    )
    assert done.stdout.split() == ["mine", str(parameters(variant("MVAE")))], done.stderr


@pytest.mark.parametrize("each", [v for v in VARIANTS if v.paper_parameters], ids=lambda each: each.name)
def test_parameters_are_near_the_papers(each: Variant) -> None:
    if each.name == "NeuralLayering":  # the number of its experts is not known
        assert parameters(each) < 1e6 * (each.paper_parameters or 0.0)
    else:
        assert parameters(each) / 1e6 == pytest.approx(each.paper_parameters, rel=0.1)


@pytest.mark.parametrize(("name", "mirrored"), [("all", False), ("all-mirrored", True)])
def test_a_training_set_has_no_test_sequence(
    paper_folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, mirrored: bool
) -> None:
    dataset = select(paper_folder, name)
    train, test = dataset.select("train"), dataset.select("test")
    assert train and test and any(clip.mirrored for clip in train) == mirrored
    assert not {(c.start, c.mirrored) for c in train} & {(c.start, c.mirrored) for c in test}
    assert all(s.frames >= 30 and s.initial in (30, 87) for s in held_out(dataset, 100))
    with pytest.raises(DatasetError, match="unknown data set 'none'"):
        select(paper_folder, "none")
    sets = paper_folder / "sets"
    sets.mkdir()
    (sets / f"{name}.json").write_text("{}")
    with pytest.raises(DatasetError, match=f"{name} is a data set of motionkit; give it another name"):
        select(paper_folder, name)
    shutil.rmtree(sets)
    monkeypatch.setitem(SELECTIONS, "empty", Selection("empty", "nothing", lambda dataset: ([], [])))
    with pytest.raises(DatasetError, match="no training clips for the data set empty"):
        select(paper_folder, "empty")


def test_an_image_without_a_type_does_not_train(tmp_path: Path) -> None:
    """Mirrored hops to the left are hops to the right, which this data does not have."""
    (tmp_path / "hops").mkdir()
    for i in range(3):
        write_bvh(tmp_path / "hops" / f"jumping-l_{i}.bvh", make_jump(150, phase=float(i), side=1.0))
        write_bvh(tmp_path / "hops" / f"walking_{i}.bvh", make_walk(150, phase=float(i)))
    options = PreprocessOptions(jobs=1, layout="expmap-root-1", smooth=False, held_out=("test",))
    preprocess([tmp_path / "hops"], tmp_path / "data", options)
    images = [clip for clip in select(tmp_path / "data", "all-mirrored").clips if clip.mirrored]
    assert images and all("walking" in clip.name for clip in images)


@pytest.fixture(scope="module")
def labelled_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset with gaits, a dance and a cartwheel, each with a training and a test clip."""
    folder = tmp_path_factory.mktemp("labelled")
    makers = {
        "walking": make_walk,
        "Tango dancing": make_dance,
        "cartwheel": make_cartwheel,
        "idle": make_idle,
    }
    lines = ["file,start_frame,end_frame,type,subject,split"]
    for kind, make in makers.items():
        for split, frames in (("train", 150), ("test", 130)):
            name = f"{kind}_{split}.bvh".replace(" ", "-")
            write_bvh(folder / name, make(frames))
            lines.append(f"{name},0,-1,{kind},P1,{split}")
    (folder / "labels.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    options = PreprocessOptions(jobs=1, layout="expmap-root-1", own_bodies=True, smooth=False)
    preprocess([folder], folder / "data", options)
    return folder / "data"


@pytest.mark.parametrize(
    ("name", "train", "test"),
    [
        ("D_L", {"walking", "cartwheel", "idle"}, {"walking", "cartwheel", "idle"}),
        ("all", {"walking", "Tango dancing", "cartwheel", "idle"}, {"walking", "Tango dancing", "cartwheel", "idle"}),
        ("all-mirrored", {"walking", "Tango dancing", "cartwheel", "idle"},
         {"walking", "Tango dancing", "cartwheel", "idle"}),
        ("no-dances", {"walking", "cartwheel", "idle"}, {"walking", "cartwheel", "idle"}),
        ("locomotion", {"walking", "idle"}, {"walking", "idle"}),
    ],
)  # fmt: skip
def test_a_data_set_runs_on_its_own_clips(
    plan: Plan, labelled_folder: Path, name: str, train: set[str], test: set[str]
) -> None:
    dataset = select(labelled_folder, name)

    def kinds(split: str) -> set[str]:
        clips = dataset.select(split)
        return {dataset.types[k] for clip in clips for k in set(dataset.clip_types(clip).tolist())}

    assert (kinds("train"), kinds("test")) == (train, test)
    here = replace(plan, data=labelled_folder, selection=name, steps=3)
    for each in ("MVAE", "last frame"):
        result = run(here, variant(each))
        assert result["data"] == name and result["text"].endswith(f"of {len(train)} types of the folder data")
        assert ("dance" in result["groups"]) == name.startswith("all")
    written = read_results(plan.results)
    assert {each["folder"] for each in written} == {f"{name}/cpu-3"}
    titles = [table.title for table in tables(written)]
    assert titles and all(name in title for title in titles)


@pytest.mark.parametrize(
    ("fields", "types", "tested", "mirrored"),
    [
        ({}, None, None, False),
        ({"text": "gaits", "types": ["walking", "running"]}, {"walking", "running"}, None, False),
        ({"test": ["*walk*"], "mirrored": True}, None, "walk", True),
    ],
)
def test_users_define_data_sets_in_a_file(
    paper_folder: Path, tmp_path: Path, fields: dict, types: set | None, tested: str | None, mirrored: bool
) -> None:
    folder = tmp_path / "data"
    shutil.copytree(paper_folder, folder)
    (folder / "sets").mkdir()
    (folder / "sets" / "mine.json").write_text(json.dumps(fields), encoding="utf-8")
    dataset = select(folder, "mine")
    train, test = dataset.select("train"), dataset.select("test")
    assert train and test and {clip.mirrored for clip in train} == {False, mirrored}
    names = {dataset.types[i] for clip in (*train, *test) for i in np.unique(dataset.clip_types(clip))}
    assert types is None or names <= types
    if tested:
        assert all(tested in clip.name for clip in test) and not any(tested in clip.name for clip in train)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('{"types": "walking"}', "expected"),
        ('{"kinds": []}', "expected"),
        ("[]", "expected"),
        ('{"types": ["walking", "runing"]}', "unknown type 'runing'"),
        ('{"test": ["*walk*", "nobody"]}', "no clip matches 'nobody'"),
    ],
)
def test_files_of_data_sets_are_checked(
    paper_folder: Path, tmp_path: Path, text: str, complaint: str
) -> None:
    folder = tmp_path / "data"
    shutil.copytree(paper_folder, folder)
    (folder / "sets").mkdir()
    (folder / "sets" / "mine.json").write_text(text, encoding="utf-8")
    with pytest.raises(DatasetError, match=rf"mine\.json: {complaint}"):
        select(folder, "mine")


@pytest.mark.parametrize(
    ("kind", "dance"), [("dance-salsa", True), ("Tango dancing", True), ("balance", False)]
)
def test_dances_are_known_by_their_label(kind: str, dance: bool) -> None:
    assert is_dance(kind) == dance


def test_types_without_a_test_clip_are_tested_on_a_mirror_image(paper_folder: Path) -> None:
    dataset = select(paper_folder, "all")
    shown = {
        dataset.types[k] for clip in dataset.select("test") for k in set(dataset.clip_types(clip).tolist())
    }
    trained = {
        dataset.types[k] for clip in dataset.select("train") for k in set(dataset.clip_types(clip).tolist())
    }
    long = {
        dataset.types[k]
        for clip in dataset.select("train")
        if clip.frames >= 60
        for k in set(dataset.clip_types(clip).tolist())
    }
    assert long <= shown and trained


def test_recorded_motion_has_the_features_of_the_recording(paper_folder: Path) -> None:
    dataset = select(paper_folder, "all")
    sequence = held_out(dataset, 30)[0]
    first, end = sequence.initial, sequence.initial + sequence.frames
    motion = dataset.motion(sequence.clip, sequence.data)
    made = features_after(dataset, motion.cut(first - 1, first), motion.cut(first, end))
    blocks = dataset.layout.blocks
    # The heading is smoothed over time, so it differs by a few thousandths of a radian near the ends.
    for block, near in (("joint_positions", 0.5), ("root_xz_velocity", 3.0), ("joint_velocities", 3.0)):
        wanted = sequence.data.features[first:end, blocks[block]]
        np.testing.assert_allclose(made[:, blocks[block]], wanted, atol=near, err_msg=block)


def test_the_shipped_model_is_measured_beside_the_others(plan: Plan) -> None:
    dataset = select(plan.data, plan.selection)
    models = {"shipped": open_model(BUNDLED), "shipped without references": open_model(BUNDLED, "none")}
    run_shipped(models, dataset, "all", 2, plan.longest, plan.results, lambda share: None)
    run(plan, variant("last frame"))
    results = read_results(plan.results)
    assert all(each["made"] == made_from(dataset) for each in results)
    assert not any("mirrored" in row["sequence"] for row in results[-1]["sequences"])
    (table,) = [t for t in tables(results) if t.title.startswith("The shipped model as shipped")]
    rows = {row[0]: row for row in table.rows}
    assert list(rows) == ["recorded", "shipped", "shipped without references", "last frame"]
    assert rows["shipped"][1] == "2" and rows["last frame"][3] == "0.0"
    assert float(rows["shipped"][3].split()[0]) > 5.0  # it moves
    # The folder of the shipped model gets no tables of its own.
    assert not any("shipped" in t.title.partition(":")[2] for t in tables(results))
