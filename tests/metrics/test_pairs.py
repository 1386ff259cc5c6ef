from __future__ import annotations

import csv
import io
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from motionkit.cli.main import main
from motionkit.export.formats import write_motion
from motionkit.metrics.pairs import PairResult, mean_rows, names_of_pairs
from motionkit.metrics.report import MetricReport, MetricRow
from motionkit.metrics.value import MetricValue
from motionkit.motion.bvh import write_bvh

from .conftest import swaying


@pytest.fixture
def folders(tmp_path: Path) -> Path:
    """truth/ and made/ with two pairs of equal names, one in a subfolder, and one unpaired file each."""
    for number, name in enumerate(("a.bvh", "deep/b.bvh", "only-truth.bvh")):
        write_bvh(tmp_path / "truth" / name, swaying(frames=40, seed=number))
    for number, name in enumerate(("a.BVH", "deep/b.bvh", "b.bvh")):
        write_bvh(tmp_path / "made" / name, swaying(frames=50, seed=number + 5))
    return tmp_path


@pytest.fixture
def metrics(
    folders: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """A function that runs the command in the folder above truth/ and made/: exit code, stdout, stderr."""
    monkeypatch.chdir(folders)

    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["motionkit", "metrics", *map(str, words)])
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        return code, *capsys.readouterr()

    return run


def test_two_folders_are_paired_by_name_and_give_what_each_pair_gives(metrics) -> None:
    code, out, err = metrics("truth", "made", "--json")
    value = json.loads(out)
    assert code == 1 and err.splitlines() == [
        "left out: truth/only-truth.bvh has no partner of the same name",
        "left out: made/b.bvh has no partner of the same name",
        "error: 0 of 2 not measured, 2 files without a partner",
    ]
    assert value["without_partner"] == ["truth/only-truth.bvh", "made/b.bvh"]
    assert [pair["ground_truth"] for pair in value["pairs"]] == ["truth/a.bvh", "truth/deep/b.bvh"]
    alone = [json.loads(metrics(p["ground_truth"], p["generated"], "--json")[1]) for p in value["pairs"]]
    assert [pair | {"taken": one["taken"]} for pair, one in zip(value["pairs"], alone, strict=True)] == alone
    jerks = [next(row["value"] for row in pair["metrics"] if row["id"] == "jerk") for pair in alone]
    both = {row["id"]: row for row in value["sets"]}
    assert set(both) == {"fid-pose", "diversity"} and both["fid-pose"]["ground_truth"] == 0.0
    assert both["fid-pose"]["value"] > 1.0 and both["diversity"]["ground_truth"] > 0.0
    mean = value["mean"]["jerk"]
    assert mean["value"] == pytest.approx(sum(jerks) / 2) and mean["count"] == 2
    assert (mean["lowest"], mean["highest"]) == (min(jerks), max(jerks))


def test_pairs_by_option_and_the_tables(metrics) -> None:
    words = ("--pair", "truth/a.bvh", "made/b.bvh", "--pair", "truth/only-truth.bvh", "made/a.BVH")
    code, out, err = metrics(*words)
    assert code == 0 and err == "" and "means of 2 pairs" in out
    assert all(word in out for word in ("b.bvh", "a.BVH", "mpjpe", "lowest", "ssim-channel", "path-coverage"))
    tables, notes = out.split("note: ", 1)
    assert max(map(len, tables.splitlines())) <= 80
    assert notes.startswith("b.bvh: ground truth has 40 frames, generated 50")


def test_a_folder_alone(metrics) -> None:
    code, out, _ = metrics("truth")
    assert code == 0 and "means of 3 files" in out and "mpjpe" not in out and "generated" not in out


def test_csv_has_a_row_for_each_metric_of_each_pair(metrics) -> None:
    _, out, _ = metrics("truth", "made", "--csv")
    rows = list(csv.DictReader(io.StringIO(out)))
    value = json.loads(metrics("truth", "made", "--json")[1])
    found = {(row["ground_truth"], row["metric"]): row for row in rows}
    count = sum(len(pair["metrics"]) for pair in value["pairs"])
    assert len(found) == len(rows) == count + len(value["sets"])
    for metric in value["sets"]:
        assert float(found["", metric["id"]]["value"]) == metric["value"]
    for pair in value["pairs"]:
        for metric in pair["metrics"]:
            row = found[pair["ground_truth"], metric["id"]]
            assert (float(row["value"]) if row["value"] else None) == metric["value"]
            truth = row["ground_truth_value"]
            assert (float(truth) if truth else None) == metric["ground_truth"] and row["unit"] == metric[
                "unit"
            ]
    single = list(csv.DictReader(io.StringIO(metrics("truth/a.bvh", "--csv")[1])))
    assert {row["generated"] for row in single} == {""} and "jerk" in {row["metric"] for row in single}


def test_a_pair_that_cannot_be_measured_is_left_out_and_named(metrics, folders: Path) -> None:
    (folders / "truth" / "a.bvh").write_text("HIERARCHY\n")
    write_bvh(folders / "one.bvh", swaying(frames=1))
    words = ("--pair", "truth/a.bvh", "made/a.BVH", "--pair", "truth/deep/b.bvh", "one.bvh")
    code, out, err = metrics(*words, "--pair", "truth/deep/b.bvh", "made/b.bvh", "--json")
    assert code == 1 and err.splitlines()[0].startswith("left out: truth/a.bvh")
    assert "truth/deep/b.bvh and one.bvh: expected at least 2 frames" in err.splitlines()[1]
    assert ["error" in pair for pair in json.loads(out)["pairs"]] == [True, True, False]


def test_both_means_are_of_the_same_pairs_and_extremes_of_all() -> None:
    """A pair of which one side has no flight tells nothing of the other side's, but may hover itself."""

    def result(made: float | None, recorded: float | None) -> PairResult:
        flight = MetricRow(MetricValue("flight", made, ""), MetricValue("flight", recorded, ""))
        mpjpe = MetricRow(MetricValue("mpjpe", 2.0, "cm"))
        return PairResult(Path("a"), Path("b"), MetricReport((flight, mpjpe), 10))

    flight, mpjpe = mean_rows([result(1.0, 2.0), result(None, 8.0), result(4.0, None), result(3.0, 6.0)])
    assert (flight.value, flight.ground_truth, flight.count) == (2.0, 4.0, 3)
    assert (flight.lowest, flight.highest) == (1.0, 4.0)
    assert (mpjpe.value, mpjpe.ground_truth, mpjpe.count) == (2.0, None, 4)


def test_jerk_at_different_rates_has_no_mean() -> None:
    reports = [
        MetricReport((MetricRow(MetricValue("jerk", value, "m/s^3", {"fps": rate})),), 10)
        for value, rate in ((894.0, 60.0), (215.0, 30.0), (180.0, 24.0))
    ]
    (jerk,) = mean_rows([PairResult(Path("a"), None, report) for report in reports])
    assert (jerk.value, jerk.lowest, jerk.highest, jerk.count) == (None, None, None, 3)
    assert jerk.as_dict()["reason"] == "values at 24, 30 and 60 fps do not compare"
    (same,) = mean_rows([PairResult(Path("a"), None, report) for report in reports[:1]])
    assert (same.value, same.lowest) == (894.0, 894.0) and "reason" not in same.as_dict()


def test_a_missing_mean_has_the_reason_of_the_pairs() -> None:
    def reason(*sides: tuple[str, str]) -> str | None:
        """The reason of the mean of pairs that miss a value for a reason of either side; "" is a value."""

        def value(why: str) -> MetricValue:
            return MetricValue("leaps", None if why else 1.0, "1/min", reason=why or None)

        rows = [MetricRow(value(mine), value(theirs)) for mine, theirs in sides]
        (mean,) = mean_rows([PairResult(Path("a"), Path("b"), MetricReport((row,), 9)) for row in rows])
        return mean.reason

    assert reason(("too short", "too short"), ("", "too short")) == "too short"
    assert reason(("too short", ""), ("", "too slow")) == "no pair has a value on both sides"
    assert reason(("", ""), ("too short", "")) is None
    alone = [MetricRow(MetricValue("jerk", None, "m/s^3", reason=why)) for why in ("2 frames", "3 frames")]
    (mean,) = mean_rows([PairResult(Path("a"), None, MetricReport((row,), 2)) for row in alone])
    assert mean.reason == "no file has a value"


def test_every_missing_value_of_the_tables_has_a_reason(metrics, folders: Path) -> None:
    write_bvh(folders / "mixed" / "fast.bvh", swaying(frames=40))
    write_bvh(folders / "mixed" / "slow.bvh", swaying(frames=20, fps=30.0))
    _, out, _ = metrics("mixed")
    assert "note: slow.bvh: leaps: leaps are single frames at 60 fps" in out
    assert (
        "note: jerk, jerk-peak, jerk-area: no mean, because values at 30 and 60 fps do not compare\n" in out
    )
    (jerk,) = [line.split() for line in out.splitlines() if line.startswith("jerk ")]
    assert jerk == ["jerk", "-", "-", "-", "m/s^3"]
    mean = json.loads(metrics("mixed", "--json")[1])["mean"]["jerk"]
    assert mean["lowest"] is None and mean["reason"] == "values at 30 and 60 fps do not compare"
    write_bvh(folders / "short" / "a.bvh", swaying(frames=5))
    _, out, _ = metrics("short", "short")
    assert "note: a.bvh: ssim-window: SSIM needs at least 12 frames, found 5\n" in out
    assert "note: diversity: diversity needs at least 2 windows, found 1\n" in out
    assert "note: fid-pose: " in out


def test_reasons_leave_room_for_the_notes(metrics, folders: Path) -> None:
    for number in range(12):
        write_bvh(folders / "short" / f"{number}.bvh", swaying(frames=3 + number % 2, fps=59.0 + number))
    _, out, _ = metrics("short")
    assert "note: 9.bvh: motion: 68 fps, resampled to 60\n" in out
    assert "SSIM" not in out and "files, such as 0.bvh: flight-acceleration: no flight\n" in out


def test_files_of_one_name_are_told_apart_by_their_folders(metrics, folders: Path) -> None:
    for number, place in enumerate(("truth/a", "truth/b", "made/a", "made/b")):
        write_bvh(folders / place / "x.bvh", swaying(frames=40 + 10 * number, seed=number), 0.01)
    _, out, _ = metrics("truth", "made")
    files = {line.split()[0] for line in out.splitlines()[1:5]}
    assert files == {"a.BVH", f"a{os.sep}x.bvh", f"b{os.sep}x.bvh", "b.bvh"}
    noted = [line for line in out.splitlines() if line.startswith(f"note: b{os.sep}x.bvh: ")]
    assert (
        f"note: b{os.sep}x.bvh: ground truth has 50 frames, generated 70; compared over the first 50" in noted
    )
    # Both files of the pair have the same name, too.
    assert sum("ground truth: 1 unit = 100 cm" in line for line in noted) == 1
    assert sum("generated motion: 1 unit = 100 cm" in line for line in noted) == 1


def test_names_of_pairs() -> None:
    def names(*pairs: tuple[str, str | None], folder: str | None = None) -> list[str]:
        results = [PairResult(Path(a), None if b is None else Path(b)) for a, b in pairs]
        return names_of_pairs(results, None if folder is None else Path(folder))

    deep = str(Path("a", "x.bvh")), str(Path("b", "x.bvh"))
    assert names(("d/a/x.bvh", None), ("d/b/x.bvh", None), ("d/b/y.bvh", None), folder="d") == [
        *deep,
        "y.bvh",
    ]
    assert names(("t.bvh", "a/x.bvh"), ("t.bvh", "b/x.bvh")) == [*deep]
    assert names(("t.bvh", "x.bvh"), ("u.bvh", "x.bvh")) == ["x.bvh against t.bvh", "x.bvh against u.bvh"]


def test_a_file_of_one_frame_is_named(metrics, folders: Path) -> None:
    write_bvh(folders / "one.bvh", swaying(frames=1))
    code, out, err = metrics("one.bvh")
    assert (code, out) == (1, "") and err.startswith(
        "error: one.bvh: expected at least 2 frames at 60 fps to measure, found 1\n"
    )


def test_a_folder_of_every_ending_by_several_processes(metrics, folders: Path) -> None:
    """All that can be read is measured; what cannot is a line, and the rest is done."""
    for ending in (".npz", ".glb"):
        write_motion(folders / "truth" / f"a{ending}", swaying(frames=40))
    (folders / "truth" / "bad.amc").write_text("no motion")
    np.savez(folders / "truth" / "arrays.npz", weights=np.ones(3))
    alone = metrics("truth", "--jobs", "1", "--json")
    assert metrics("truth", "--jobs", "2", "--json") == alone
    code, out, err = alone
    assert code == 1 and err.splitlines()[-1] == "error: 1 of 6 not measured, 0 files without a partner"
    assert "left out: truth/bad.amc: " in err
    rows = {pair["ground_truth"]: pair.get("metrics") for pair in json.loads(out)["pairs"]}
    assert list(rows) == ["truth/a.bvh", "truth/a.glb", "truth/a.npz", "truth/bad.amc", "truth/deep/b.bvh",
                          "truth/only-truth.bvh"]  # fmt: skip
    jerks = {
        row["value"]
        for name in ("bvh", "glb", "npz")
        for row in rows[f"truth/a.{name}"]
        if row["id"] == "jerk"
    }
    assert max(jerks) == pytest.approx(min(jerks), rel=0.01)


def test_pairs_of_other_endings(metrics, folders: Path) -> None:
    """One clip of each folder by a name is a pair whatever its ending; of several, those of the same ending are."""
    write_motion(folders / "made" / "only-truth.npz", swaying(frames=40))
    write_motion(folders / "made" / "a.glb", swaying(frames=40))
    code, out, err = metrics("truth", "made", "--json", "--jobs", "1")
    assert [(Path(p["ground_truth"]).name, Path(p["generated"]).name) for p in json.loads(out)["pairs"]] == [
        ("a.bvh", "a.BVH"), ("b.bvh", "b.bvh"), ("only-truth.bvh", "only-truth.npz"),
    ]  # fmt: skip
    assert code == 1 and "a.glb has no partner" in err and "made/b.bvh has no partner" in err


@pytest.mark.parametrize(
    "words",
    [
        ["truth", "made/b.bvh"],
        ["truth", "--pair", "truth/a.bvh", "made/b.bvh"],
        ["truth", "made", "--view"],
        ["truth", "made", "--json", "--csv"],
        ["truth", "--align-start"],
        ["--pair", "truth/a.bvh"],
    ],
)
def test_wrong_usage(metrics, words: list[str]) -> None:
    code, out, err = metrics(*words)
    assert code == 2 and not out and "Error: " in err


def test_folders_without_pairs(metrics, folders: Path) -> None:
    (folders / "empty").mkdir()
    assert metrics("empty") == (1, "", "error: empty: no .bvh, .amc, .npz, .glb, .vrm or .fbx files found\n")
    assert metrics("truth", "empty") == (
        1,
        "",
        "error: truth and empty: no two files of motion have the same name\n",
    )
