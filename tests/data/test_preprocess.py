from __future__ import annotations

import json
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motionkit.data import first_pass, second_pass
from motionkit.data.dataset import Clip, Dataset
from motionkit.data.diagnosis import diagnose
from motionkit.data.options import PreprocessOptions
from motionkit.data.preprocess import preprocess
from motionkit.errors import DatasetError
from motionkit.export.clip import Clip as MotionClip
from motionkit.export.formats import write_motion
from motionkit.features.decode import decode_motion, joint_positions
from motionkit.features.layout import LAYOUTS
from motionkit.motion.bvh import read_bvh, write_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.motion import resample
from motionkit.motion.skeleton import JOINT_NAMES, canonical_skeleton
from motionkit.rig.retarget import retarget_file
from synthetic_motions import make_idle, make_jump, make_walk

ONE_JOB = PreprocessOptions(jobs=1)


@pytest.fixture(scope="module")
def raw_dataset(clips_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The dataset without the filter."""
    output = tmp_path_factory.mktemp("raw") / "dataset"
    preprocess([clips_folder], output, replace(ONE_JOB, smooth=False))
    return Dataset(output)


def files_in(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def clips_by_file(dataset: Dataset) -> dict[str, list[Clip]]:
    out: dict[str, list[Clip]] = {}
    for clip in dataset.clips:
        name = Path(clip.name.removesuffix(" (mirrored)").split(":")[0]).name
        out.setdefault(name, []).append(clip)
    return out


# ---- the dataset of the shared clips ----


def test_folder_holds_the_arrays_and_the_manifest_and_nothing_else(dataset_folder: Path) -> None:
    expected = ["contacts.npy", "features.npy", "ground.npy", "manifest.json", "phases.npy", "types.npy"]
    assert files_in(dataset_folder) == expected


def test_nothing_is_left_beside_the_dataset(dataset_folder: Path) -> None:
    assert [p.name for p in dataset_folder.parent.iterdir()] == [dataset_folder.name]


def test_types_rate_and_frames(dataset: Dataset) -> None:
    assert dataset.types == ("cartwheel", "idle", "jumping-l", "jumping-r", "running", "walking")
    assert dataset.fps == 60.0
    frames = {name: clips[0].frames for name, clips in clips_by_file(dataset).items()}
    assert frames["walk_02.bvh"] == 200
    assert frames["run_01.bvh"] == 150, "300 frames at 120 fps are 150 at 60"


def test_the_split_in_the_labels_is_kept(dataset: Dataset) -> None:
    by_file = clips_by_file(dataset)
    assert [c.split for c in by_file["walk_03.bvh"]] == ["test"], "and test clips have no twin"
    trained = {name for name, clips in by_file.items() if any(c.split == "train" for c in clips)}
    assert trained == set(by_file) - {"walk_03.bvh"}


def test_stretches_that_touch_stay_one_clip_of_two_types(dataset: Dataset) -> None:
    clip = clips_by_file(dataset)["walk_01.bvh"][0]
    names = [dataset.types[i] for i in dataset.clip_types(clip).tolist()]
    assert names == ["walking"] * 120 + ["running"] * 120


def test_training_clips_have_mirrored_twins_of_the_mirrored_type(dataset: Dataset) -> None:
    for name, clips in clips_by_file(dataset).items():
        if name != "walk_03.bvh":
            assert [c.mirrored for c in clips] == [False, True]
            assert clips[0].start == clips[1].start and clips[0].frames == clips[1].frames
    plain, twin = clips_by_file(dataset)["hop_left.bvh"]
    assert dataset.types[int(dataset.clip_types(plain)[0])] == "jumping-l"
    assert dataset.types[int(dataset.clip_types(twin)[0])] == "jumping-r"
    plain, twin = clips_by_file(dataset)["hop_right.bvh"]
    assert dataset.types[int(dataset.read(twin).types[0])] == "jumping-l"


def test_a_twin_shows_the_other_foot_on_the_floor(dataset: Dataset) -> None:
    plain, twin = (dataset.read(c) for c in clips_by_file(dataset)["hop_left.bvh"])
    assert plain.contacts[:, :2].any() and not plain.contacts[:, 2:].any()
    assert np.array_equal(twin.contacts, plain.contacts[:, [2, 3, 0, 1]])


@pytest.mark.parametrize("name", ["walk_02.bvh", "wheel_01.bvh", "hop_right.bvh", "run_01.bvh"])
@pytest.mark.parametrize(("how", "apart"), [("raw", 0.05), ("smooth", 2.5)])
def test_from_bvh_to_features_and_back(
    dataset: Dataset, raw_dataset: Dataset, clips_folder: Path, name: str, how: str, apart: float
) -> None:
    """The motion in a dataset equals that in the file, except for floor height and jitter."""
    dataset = raw_dataset if how == "raw" else dataset
    clip = clips_by_file(dataset)[name][0]
    data = dataset.read(clip)
    back = decode_motion(
        data.features,
        dataset.skeleton(clip),
        60.0,
        data.ground[0],
        dataset.reference_rotations,
        dataset.layout.version,
    )
    truth = resample(retarget_file(clips_folder / name)[0], 60.0)
    shift = np.zeros(3, np.float32)
    shift[1] = np.median((back.root_positions - truth.root_positions)[:, 1])
    distance = np.linalg.norm(motion_kinematics(back)[1] - motion_kinematics(truth)[1] - shift, axis=-1)
    assert distance.max() < apart


def test_scaling_is_that_of_the_training_clips_and_their_twins(dataset: Dataset) -> None:
    rows = np.concatenate([dataset.read(c).features for c in dataset.select("train")])
    assert np.allclose(dataset.scaling.mean, rows.mean(0), atol=1e-3)
    block = dataset.layout.blocks["joint_velocities"]
    std = rows.std(0)[block]
    moving = std > 0.2 * np.sqrt(np.square(std).mean())
    assert np.allclose(dataset.scaling.std[block][moving], std[moving], rtol=1e-3)


def test_manifest_tells_what_was_done_to_each_file(dataset_folder: Path, clips_folder: Path) -> None:
    manifest = json.loads((dataset_folder / "manifest.json").read_text())
    assert len(manifest["files"]) == len(list(clips_folder.glob("*.bvh")))
    entry = next(f for f in manifest["files"] if f["name"].endswith("walk_01.bvh"))
    assert entry["clips"] == 1 and entry["frames"] == 240 and not entry["skipped"]
    assert len(entry["sha256"]) == 64
    assert entry["mapping"]["source_joints"] == 23 and entry["mapping"]["missing"] == []
    assert {"lead_in", "pops", "floor_shift"} <= set(entry["cleaning"])


# ---- small folders of their own ----


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of three short clips named after their types, without labels."""
    folder = tmp_path / "clips"
    folder.mkdir()
    write_bvh(folder / "walk_1.bvh", make_walk(60))
    write_bvh(folder / "walk_2.bvh", make_walk(50, turn=-0.5))
    write_bvh(folder / "idle.bvh", make_idle(40))
    return folder


def test_digest_knows_files_and_types_but_not_last_bits(dataset_folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(dataset_folder, copy)
    ground = np.load(copy / "ground.npy")
    np.save(copy / "ground.npy", np.nextafter(ground, np.inf))
    digest = Dataset(dataset_folder).digest()
    assert Dataset(copy).digest() == digest != Dataset(copy).digest("test")
    manifest = json.loads((copy / "manifest.json").read_text())
    for file in manifest["files"]:
        file["sha256"] = file["sha256"][::-1]
    (copy / "manifest.json").write_text(json.dumps(manifest))
    assert Dataset(copy).digest() != digest
    types = np.load(dataset_folder / "types.npy")
    np.save(copy / "types.npy", np.roll(types, 1))
    shutil.copy(dataset_folder / "manifest.json", copy)
    assert Dataset(copy).digest() != digest


def test_types_come_from_file_names_where_nothing_else_tells(folder: Path, tmp_path: Path) -> None:
    report = preprocess([folder], tmp_path / "out", ONE_JOB)
    assert report.labels is None
    assert Dataset(tmp_path / "out").types == ("idle", "walk")


def test_types_come_from_folder_names(tmp_path: Path) -> None:
    for kind, motion in (("stand", make_idle(40)), ("stroll", make_walk(40))):
        (tmp_path / "clips" / kind).mkdir(parents=True)
        write_bvh(tmp_path / "clips" / kind / "take_01.bvh", motion)
    preprocess([tmp_path / "clips"], tmp_path / "out", ONE_JOB)
    assert Dataset(tmp_path / "out").types == ("stand", "stroll")


def test_whole_clips_are_held_out_where_the_labels_do_not_say(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    for i in range(6):
        write_bvh(tmp_path / "clips" / f"walk_{i}.bvh", make_walk(40, phase=float(i)))
    preprocess([tmp_path / "clips"], tmp_path / "out", ONE_JOB)
    by_file = clips_by_file(Dataset(tmp_path / "out"))
    splits = Counter(clips[0].split for clips in by_file.values())
    assert splits == {"train": 4, "validation": 1, "test": 1}
    assert all(len({c.split for c in clips}) == 1 for clips in by_file.values())
    assert all(len(clips) == 2 if clips[0].split == "train" else 1 for clips in by_file.values()), (
        "twins train"
    )


def test_parts_of_one_take_are_tested_or_trained_on_together(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    rows = ["file,start_frame,end_frame,type"]
    for i in range(4):
        write_bvh(tmp_path / "clips" / f"walk_{i}.bvh", make_walk(120, phase=float(i)))
        rows += [f"walk_{i}.bvh,{at},{at + 30},walking" for at in (0, 40, 80)]
    write_bvh(tmp_path / "clips" / "idle.bvh", make_idle(120))
    rows += ["idle.bvh,0,40,idle", "idle.bvh,50,90,idle"]
    (tmp_path / "clips" / "labels.csv").write_text("\n".join(rows) + "\n", "utf-8")
    preprocess([tmp_path / "clips"], tmp_path / "out", replace(ONE_JOB, held_out=("test",)))
    found = clips_by_file(Dataset(tmp_path / "out"))
    splits = {name: {(clip.split, clip.mirrored) for clip in clips} for name, clips in found.items()}
    tested = [name for name, each in splits.items() if each == {("test", False)}]
    assert len(tested) == 1 and tested[0].startswith("walk")
    assert len(splits.pop("idle.bvh")) == 2, "both parts train, and both images test, or the reverse"
    assert all(
        each == {("train", False), ("train", True)} for name, each in splits.items() if name not in tested
    )


def test_stretches_of_two_performers_are_two_clips(tmp_path: Path) -> None:
    write_bvh(tmp_path / "clips.bvh", make_walk(120))
    (tmp_path / "labels.csv").write_text(
        "file,start_frame,end_frame,type,subject\nclips.bvh,0,60,walking,anna\nclips.bvh,60,120,walking,bert\n"
    )
    preprocess([tmp_path / "clips.bvh"], tmp_path / "out", replace(ONE_JOB, mirror=False, held_out=()))
    assert [clip.subject for clip in Dataset(tmp_path / "out").clips] == ["anna", "bert"]


def test_mirror_images_have_mirrored_bodies(tmp_path: Path) -> None:
    """Positions in the features are those of the skeleton, for a body whose left shin is longer, too."""
    walk = make_walk(60)
    offsets = walk.skeleton.offsets.copy()
    offsets[JOINT_NAMES.index("LeftFoot")] *= 1.1
    write_bvh(tmp_path / "walk.bvh", replace(walk, skeleton=canonical_skeleton(offsets)))
    preprocess([tmp_path / "walk.bvh"], tmp_path / "out", replace(ONE_JOB, own_bodies=True, held_out=()))
    dataset = Dataset(tmp_path / "out")
    plain, image = dataset.clips
    assert image.mirrored and image.body != plain.body and dataset.image(image) == plain
    assert dataset.image(plain) == image
    for clip in dataset.clips:
        data = dataset.read(clip)
        places = motion_kinematics(dataset.motion(clip, data))[1]
        heights = joint_positions(data.features, dataset.layout.version)[..., 1]
        assert np.abs(heights - places[..., 1]).max() < 0.01


def test_all_clips_train_if_none_is_to_be_held_out(tmp_path: Path) -> None:
    """A type with one clip then trains on it and on its mirror image, not on one of the two."""
    (tmp_path / "clips").mkdir()
    for i in range(4):
        write_bvh(tmp_path / "clips" / f"walk_{i}.bvh", make_walk(40, phase=float(i)))
    write_bvh(tmp_path / "clips" / "idle.bvh", make_idle(40))
    preprocess([tmp_path / "clips"], tmp_path / "out", PreprocessOptions(jobs=1, held_out=()))
    assert [clip.split for clip in Dataset(tmp_path / "out").clips] == ["train"] * 10


def test_validation_is_held_out_file_by_file_and_type_by_type(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    rows = ["file,start_frame,end_frame,type,split"]
    for i in range(5):
        write_bvh(tmp_path / "clips" / f"walk_{i}.bvh", make_walk(120, phase=float(i)))
        rows += [f"walk_{i}.bvh,0,50,walking,train", f"walk_{i}.bvh,60,110,walking,train"]
    for i in range(3):
        write_bvh(tmp_path / "clips" / f"idle_{i}.bvh", make_idle(60, phase=float(i)))
        rows.append(f"idle_{i}.bvh,0,-1,idle,train")
    (tmp_path / "clips" / "labels.csv").write_text("\n".join(rows) + "\n", "utf-8")

    def splits(folder: str, *files: Path, **options: tuple[str, ...]) -> dict[str, set[str]]:
        preprocess(
            list(files) or [tmp_path / "clips"], tmp_path / folder, PreprocessOptions(jobs=1, **options)
        )
        found = clips_by_file(Dataset(tmp_path / folder))
        return {name: {clip.split for clip in clips} for name, clips in found.items()}

    chosen = splits("out")
    held = [name for name, split in chosen.items() if split == {"validation"}]
    assert len(held) == 1 and held[0].startswith("walk"), "both its clips, and none of a type of three files"
    assert all(split == {"train"} for name, split in chosen.items() if name not in held)
    data = Dataset(tmp_path / "out")
    assert {clip.mirrored for clip in data.select("validation")} == {False} and len(
        data.select("validation")
    ) == 2
    assert splits("all", held_out=("test",)) == {name: {"train"} for name in chosen}
    # The choice does not depend on other types, and labels that name validation clips have the last word.
    (tmp_path / "clips" / "labels.csv").write_text("\n".join(rows[:11]) + "\n", "utf-8")
    assert [name for name, split in splits("fewer").items() if split == {"validation"}] == held
    named = "\n".join(row.replace("train", "validation") if "walk_3" in row else row for row in rows)
    (tmp_path / "clips" / "labels.csv").write_text(named + "\n", "utf-8")
    assert [name for name, split in splits("named").items() if split == {"validation"}] == ["walk_3.bvh"]


def test_a_type_with_one_clip_trains_on_it_and_tests_on_its_mirror_image(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    for kind in "abcdefgh":
        write_bvh(tmp_path / "clips" / f"{kind}x.bvh", make_walk(30, phase=float(ord(kind))))
    report = preprocess([tmp_path / "clips"], tmp_path / "out", ONE_JOB)
    trained_on_mirror = 0
    for clips in clips_by_file(Dataset(tmp_path / "out")).values():
        assert sorted(c.split for c in clips) == ["test", "train"]
        assert {c.mirrored for c in clips} == {False, True}
        trained_on_mirror += next(c for c in clips if c.split == "train").mirrored
    assert 0 < trained_on_mirror < 8, "some train on the recording, some on its mirror image"
    assert all(row["train_seconds"] == pytest.approx(0.5) for row in report.types.values())


def test_one_sided_types_with_one_clip_each_both_train(tmp_path: Path) -> None:
    """The mirror image of the only jumping-l shows jumping-r: it cannot test jumping-l, nor train it."""
    for take in range(8):  # which clip a mirror trick would train on depends on its name
        clips = tmp_path / f"clips{take}"
        clips.mkdir()
        write_bvh(clips / f"jumping-l_{take}.bvh", make_jump(40, side=1.0))
        write_bvh(clips / f"jumping-r_{take}.bvh", make_jump(40, side=-1.0))
        preprocess([clips], tmp_path / "out", ONE_JOB)
        dataset = Dataset(tmp_path / "out")
        trained = {int(dataset.clip_types(c)[0]) for c in dataset.select("train")}
        assert trained == {0, 1}


def test_a_file_whose_split_is_open_is_not_the_only_one_beside_those_that_are_named(tmp_path: Path) -> None:
    """Its mirror image would test beside real test clips, though the file trains."""
    (tmp_path / "clips").mkdir()
    rows = ["file,start_frame,end_frame,type,split"]
    for number, split in enumerate(("train", "train", "", "test")):
        write_bvh(tmp_path / "clips" / f"{number}.bvh", make_walk(30, phase=float(number)))
        rows.append(f"{number}.bvh,0,-1,walking,{split}")
    (tmp_path / "clips" / "labels.csv").write_text("\n".join(rows) + "\n", "utf-8")
    preprocess([tmp_path / "clips"], tmp_path / "out", ONE_JOB)
    clips = clips_by_file(Dataset(tmp_path / "out"))["2.bvh"]
    assert {(c.split, c.mirrored) for c in clips} == {("train", False), ("train", True)}


def test_a_one_sided_type_alone_is_never_shown_mirrored(tmp_path: Path) -> None:
    """Its mirror image would have the wrong label, in training as in testing."""
    for take in range(8):
        clips = tmp_path / f"clips{take}"
        clips.mkdir()
        write_bvh(clips / f"jumping-l_{take}.bvh", make_jump(40, side=1.0))
        preprocess([clips], tmp_path / "out", ONE_JOB)
        assert not any(c.mirrored for c in Dataset(tmp_path / "out").clips)


def test_without_mirroring_there_are_no_twins(folder: Path, tmp_path: Path) -> None:
    preprocess([folder], tmp_path / "out", replace(ONE_JOB, mirror=False))
    dataset = Dataset(tmp_path / "out")
    assert not any(clip.mirrored for clip in dataset.clips)
    assert {dataset.types[i] for c in dataset.select("train") for i in dataset.clip_types(c)} == set(
        dataset.types
    )


def test_a_broken_file_is_skipped_with_its_reason_and_the_rest_goes_on(folder: Path, tmp_path: Path) -> None:
    (folder / "walk_3.bvh").write_text("HIERARCHY\nROOT Hips\n{\n")
    (folder / "walk_4.bvh").write_bytes(b"")
    report = preprocess([folder], tmp_path / "out", ONE_JOB)
    skipped = {f.name: f.skipped for f in report.files if f.skipped}
    assert set(skipped) == {"walk_3.bvh", "walk_4.bvh"}
    assert all(name in reason and "\n" not in reason for name, reason in skipped.items())
    assert sum(f.clips for f in report.files) == 3
    assert len(Dataset(tmp_path / "out").manifest["files"]) == 5


def test_strict_stops_at_a_broken_file_and_leaves_nothing(folder: Path, tmp_path: Path) -> None:
    (folder / "walk_3.bvh").write_text("HIERARCHY\nROOT Hips\n{\n")
    with pytest.raises(DatasetError, match=r"walk_3\.bvh.*--strict"):
        preprocess([folder], tmp_path / "out", replace(ONE_JOB, strict=True))
    assert [p.name for p in tmp_path.iterdir()] == ["clips"]


def test_strict_does_not_mind_files_the_labels_leave_out(folder: Path, tmp_path: Path) -> None:
    (folder / "labels.csv").write_text("file,start_frame,end_frame,type\nwalk_1.bvh,0,-1,walking\n")
    report = preprocess([folder], tmp_path / "out", replace(ONE_JOB, strict=True))
    assert {f.name.split("/")[-1]: f.skipped for f in report.files} == {
        "walk_1.bvh": "",
        "walk_2.bvh": "not in labels.csv",
        "idle.bvh": "not in labels.csv",
    }


def test_no_usable_file_at_all(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    (tmp_path / "clips" / "a.bvh").write_text("nothing")
    with pytest.raises(DatasetError, match="none of the 1 files is usable"):
        preprocess([tmp_path / "clips"], tmp_path / "out", ONE_JOB)
    assert [p.name for p in tmp_path.iterdir()] == ["clips"]


@pytest.mark.parametrize(
    "fault", [RuntimeError("power cut"), KeyboardInterrupt(), OSError(28, "No space left")]
)
@pytest.mark.parametrize("stage", ["prepare_file", "_encode_file"])
def test_a_fault_in_the_middle_leaves_no_folder(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: str, fault: BaseException
) -> None:
    module = first_pass if stage == "prepare_file" else second_pass
    honest, calls = getattr(module, stage), []

    def breaks(item: object) -> object:
        calls.append(item)
        if len(calls) == 2:
            raise fault
        return honest(item)

    monkeypatch.setattr(module, stage, breaks)
    expected = DatasetError if isinstance(fault, OSError) else type(fault)
    with pytest.raises(expected):
        preprocess([folder], tmp_path / "out", ONE_JOB)
    assert len(calls) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["clips"]


def test_a_fault_leaves_the_old_dataset_as_it_was(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    preprocess([folder], tmp_path / "out", ONE_JOB)
    before = (tmp_path / "out" / "manifest.json").read_bytes()
    monkeypatch.setattr(second_pass, "_encode_file", lambda item: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        preprocess([folder], tmp_path / "out", ONE_JOB)
    assert (tmp_path / "out" / "manifest.json").read_bytes() == before
    Dataset(tmp_path / "out")


def test_an_old_dataset_is_replaced(folder: Path, tmp_path: Path) -> None:
    preprocess([folder], tmp_path / "out", ONE_JOB)
    (folder / "idle.bvh").unlink()
    preprocess([folder], tmp_path / "out", ONE_JOB)
    assert Dataset(tmp_path / "out").types == ("walk",)


def test_a_folder_that_is_no_dataset_is_refused(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "thesis.txt").write_text("years of work")
    with pytest.raises(DatasetError, match="exists and is not a dataset folder"):
        preprocess([folder], tmp_path / "precious", ONE_JOB)
    assert files_in(tmp_path / "precious") == ["thesis.txt"]


def test_a_folder_with_somebody_elses_manifest_is_refused(folder: Path, tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "manifest.json").write_text('{"name": "my web app", "version": 3}')
    (precious / "app.js").write_text("years of work")
    with pytest.raises(DatasetError, match="exists and is not a dataset folder"):
        preprocess([folder], precious, ONE_JOB)
    assert files_in(precious) == ["app.js", "manifest.json"]


def test_a_file_in_the_place_of_the_dataset_is_refused(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(DatasetError, match="exists and is not a dataset folder"):
        preprocess([folder], tmp_path / "out", ONE_JOB)
    assert (tmp_path / "out").read_text() == "a file"


def test_an_empty_folder_may_become_a_dataset(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    preprocess([folder], tmp_path / "out", ONE_JOB)
    assert Dataset(tmp_path / "out").clips


def test_two_processes_make_the_dataset_one_makes(
    clips_folder: Path, dataset_folder: Path, tmp_path: Path
) -> None:
    preprocess([clips_folder], tmp_path / "out", replace(ONE_JOB, jobs=2))
    for name in files_in(dataset_folder):
        assert (tmp_path / "out" / name).read_bytes() == (dataset_folder / name).read_bytes(), name


def test_short_stretches_are_not_clips(folder: Path, tmp_path: Path) -> None:
    (folder / "labels.csv").write_text(
        "file,start_frame,end_frame,type\nwalk_1.bvh,0,10,walking\nwalk_2.bvh,0,30,walking\n"
    )
    report = preprocess([folder], tmp_path / "out", ONE_JOB)
    reasons = {f.name.split("/")[-1]: f.skipped for f in report.files}
    assert "no labelled stretch of at least 16 frames" in reasons["walk_1.bvh"]
    assert report.clips == 2


def test_the_true_rate_in_the_labels_overrides_the_header(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    bvh = read_bvh_of(make_walk(120, fps=120.0), tmp_path)
    write_bvh(tmp_path / "clips" / "salsa.bvh", replace(bvh, frame_time=1 / 60))
    labels = tmp_path / "clips" / "labels.csv"
    labels.write_text("file,start_frame,end_frame,type,fps\nsalsa.bvh,0,-1,salsa,120\n")
    preprocess([tmp_path / "clips"], tmp_path / "out", replace(ONE_JOB, fps=30.0))
    clip = Dataset(tmp_path / "out").clips[0]
    assert clip.frames == 60
    assert np.median(Dataset(tmp_path / "out").read(clip).features[5:55, 2]) == pytest.approx(120.0, rel=0.05)


def read_bvh_of(motion, tmp_path: Path):
    write_bvh(tmp_path / "scratch.bvh", motion)
    return read_bvh(tmp_path / "scratch.bvh")


def test_other_units_become_centimetres(folder: Path, tmp_path: Path) -> None:
    write_bvh(folder / "walk_1.bvh", make_walk(60), scale=0.01)  # metres
    write_bvh(folder / "walk_2.bvh", make_walk(60), scale=0.45 / 2.54)  # as the CMU files
    report = preprocess([folder], tmp_path / "out", ONE_JOB)
    scales = {f.name: f.mapping["scale"] for f in report.files}
    assert scales["walk_1.bvh"] == pytest.approx(100.0)
    assert scales["walk_2.bvh"] == pytest.approx(2.54 / 0.45)
    dataset = Dataset(tmp_path / "out")
    column = dataset.layout.blocks["joint_positions"].start
    heights = {c.name: float(dataset.read(c).features[:, column].mean()) for c in dataset.clips}
    assert all(80.0 < height < 110.0 for height in heights.values())


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layout_is_kept_in_the_manifest(folder: Path, tmp_path: Path, layout: str) -> None:
    preprocess([folder], tmp_path / "out", replace(ONE_JOB, layout=layout))
    assert Dataset(tmp_path / "out").layout.version == layout


def test_progress_counts_both_passes(folder: Path, tmp_path: Path) -> None:
    seen: list[tuple[str, int, int]] = []
    preprocess([folder], tmp_path / "out", ONE_JOB, lambda *event: seen.append(event))
    assert seen == [(stage, i, 3) for stage in ("reading", "encoding") for i in (1, 2, 3)]


# ---- opening a dataset ----


@pytest.fixture
def copy(dataset_folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(dataset_folder, tmp_path / "copy"))


def test_a_folder_without_a_manifest(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="not a dataset folder"):
        Dataset(tmp_path)


@pytest.mark.parametrize("text", ["", "not json", "[1, 2]", "{}", '{"format": 99}', '{"format": 1}'])
def test_a_damaged_manifest(copy: Path, text: str) -> None:
    (copy / "manifest.json").write_text(text)
    with pytest.raises(DatasetError, match=r"manifest\.json") as caught:
        Dataset(copy)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["features.npy", "contacts.npy", "ground.npy", "types.npy"])
def test_a_missing_truncated_or_short_array(copy: Path, name: str) -> None:
    whole = (copy / name).read_bytes()
    (copy / name).write_bytes(whole[:-200])
    with pytest.raises(DatasetError, match=name):
        Dataset(copy)
    (copy / name).write_bytes(b"")
    with pytest.raises(DatasetError, match=name):
        Dataset(copy)
    np.save(copy / name, np.load(dataset_array(copy, name, whole))[:-5])
    with pytest.raises(DatasetError, match=name):
        Dataset(copy)
    (copy / name).unlink()
    with pytest.raises(DatasetError, match=name):
        Dataset(copy)


def dataset_array(copy: Path, name: str, whole: bytes) -> Path:
    path = copy.parent / name
    path.write_bytes(whole)
    return path


def test_reading_part_of_a_clip(dataset: Dataset) -> None:
    for clip in dataset.clips[:2]:
        whole, part = dataset.read(clip), dataset.read(clip, 10, 30)
        assert np.array_equal(whole.features[10:30], part.features)
        assert np.array_equal(whole.types[10:30], part.types)
        assert len(dataset.read(clip, 10, 10**6).features) == clip.frames - 10


def test_a_take_of_several_types_is_held_out_whole(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    rows = ["file,start_frame,end_frame,type"]
    for i in range(8):
        write_bvh(tmp_path / "clips" / f"take_{i}.bvh", make_walk(120, phase=float(i)))
        kinds = ("walking", "idle", "hop") if i < 6 else ("walking", "turn", "turn")
        rows += [f"take_{i}.bvh,{40 * n},{40 * n + 30},{kind}" for n, kind in enumerate(kinds)]
    (tmp_path / "clips" / "labels.csv").write_text("\n".join(rows) + "\n", "utf-8")
    preprocess([tmp_path / "clips"], tmp_path / "out", PreprocessOptions(jobs=1))
    splits = {
        name: {clip.split for clip in each} for name, each in clips_by_file(Dataset(tmp_path / "out")).items()
    }
    assert all(len(each) == 1 for each in splits.values()), splits
    assert {"train", "test", "validation"} == {split for each in splits.values() for split in each}
    kinds = {kind for *_, kind in Dataset(tmp_path / "out").stretches("train")}
    assert kinds == {"walking", "idle", "hop", "turn"}


def test_a_short_part_of_another_type_keeps_training(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    for i in range(8):
        write_bvh(tmp_path / "clips" / f"walk_{i}.bvh", make_walk(60, phase=float(i)))
    plain = PreprocessOptions(jobs=1)
    preprocess([tmp_path / "clips"], tmp_path / "out", plain)
    held = [clip.name for clip in Dataset(tmp_path / "out").clips if clip.split != "train"]
    assert len(held) == 2
    rows = [f"walk_{i}.bvh,0,{40 if f'walk_{i}.bvh' in held else -1},walk" for i in range(8)]
    rows += [f"{name},40,-1,turn-{n}" for n, name in enumerate(held)]
    (tmp_path / "clips" / "labels.csv").write_text(
        "\n".join(["file,start_frame,end_frame,type", *rows]) + "\n"
    )
    preprocess([tmp_path / "clips"], tmp_path / "out", plain)
    kinds = {kind for *_, kind in Dataset(tmp_path / "out").stretches("train")}
    assert kinds == {"walk", "turn-0", "turn-1"}


def test_a_type_without_a_whole_stretch_is_told(folder: Path, tmp_path: Path) -> None:
    (folder / "labels.csv").write_text(
        "file,start_frame,end_frame,type\nwalk_1.bvh,0,30,walking\nwalk_1.bvh,40,50,waving\n"
    )
    report = preprocess([folder], tmp_path / "out", ONE_JOB)
    told = "no stretch of it has 16 frames at 60 fps"
    assert report.notes == (f"warning: waving: left out, for {told}",)
    assert f"waving: {told}; give it longer clips" in diagnose([folder]).warnings


def test_a_short_part_of_a_longer_stretch_is_not_left_out(folder: Path, tmp_path: Path) -> None:
    """Yet doctor tells it, as nobody can learn from it."""
    (folder / "labels.csv").write_text(
        "file,start_frame,end_frame,type\nwalk_1.bvh,0,30,walking\nwalk_1.bvh,30,40,waving\n"
    )
    assert not preprocess([folder], tmp_path / "out", ONE_JOB).notes
    assert Dataset(tmp_path / "out").types == ("walking", "waving")
    (line,) = [line for line in diagnose([folder]).warnings if line.startswith("waving: ")]
    assert "left out" not in line


def test_a_label_at_the_end_of_a_clip_is_told(folder: Path, tmp_path: Path) -> None:
    (folder / "labels.csv").write_text(
        "file,start_frame,end_frame,type\nwalk_1.bvh,0,60,walking\nwalk_1.bvh,60,-1,waving\n"
    )
    report = preprocess([folder], tmp_path / "out", ONE_JOB)
    assert len(report.notes) == 1 and report.notes[0].startswith("warning: waving: left out")


def test_features_that_are_not_levelled_are_others(dataset_folder: Path, tmp_path: Path) -> None:
    digest = Dataset(dataset_folder).digest()
    copy = tmp_path / "copy"
    shutil.copytree(dataset_folder, copy)
    manifest = json.loads((copy / "manifest.json").read_text())
    for levelled, same in ((None, True), (True, True), (False, False)):
        told = {key: value for key, value in manifest.items() if key != "levelled"}
        told |= {} if levelled is None else {"levelled": levelled}
        (copy / "manifest.json").write_text(json.dumps(told))
        assert (Dataset(copy).digest() == digest) == same


def test_other_frames_of_a_file_are_others(tmp_path: Path) -> None:
    """Clips of one file, length and type, and frames of their own; a first frame of 0 is as in earlier releases."""
    write_bvh(tmp_path / "walk.bvh", make_walk(120))

    def digest(first: int, second: int, wrote: bool = True) -> str:
        rows = [f"walk.bvh,{start},{start + 30},walking,train" for start in (first, second)]
        (tmp_path / "labels.csv").write_text(
            "\n".join(["file,start_frame,end_frame,type,split", *rows]) + "\n"
        )
        preprocess([tmp_path / "walk.bvh"], tmp_path / "out", replace(ONE_JOB, held_out=()))
        dataset = Dataset(tmp_path / "out")
        for file in dataset.manifest["files"] if not wrote else ():
            del file["starts"]
        return dataset.digest()

    assert len({digest(0, 40), digest(0, 50), digest(5, 40), digest(0, 40, wrote=False)}) == 4
    assert digest(0, 40, wrote=False) == digest(5, 50, wrote=False)
    for level in (True, False):
        preprocess([tmp_path / "walk.bvh"], tmp_path / "out", replace(ONE_JOB, level=level))
        assert Dataset(tmp_path / "out").manifest["levelled"] is level


def test_two_label_tables_are_refused(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_bvh(tmp_path / name / "walk.bvh", make_walk(60))
        (tmp_path / name / "labels.csv").write_text(
            f"file,start_frame,end_frame,type\nwalk.bvh,0,-1,{name}\n"
        )
    with pytest.raises(DatasetError, match=r"b/labels.csv: expected one table; give it with --labels"):
        preprocess([tmp_path / "a", tmp_path / "b"], tmp_path / "out", ONE_JOB)


def test_an_animation_that_only_clip_all_takes(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    write_motion(tmp_path / "clips" / "a.glb", MotionClip(make_walk(60), "go"))
    (tmp_path / "clips" / "labels.csv").write_text(
        "file,start_frame,end_frame,type\na.glb#go,0,-1,walk\na.glb,0,-1,walk\n"
    )
    report = preprocess([tmp_path / "clips"], tmp_path / "out", ONE_JOB)
    assert "only with --clip all" in next(file.skipped for file in report.files if file.skipped)
