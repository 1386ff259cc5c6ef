"""The commands of `motionkit experiment`: what they refuse, say, and fit into a narrow terminal."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from motionkit.cli.experiment.rollouts import BODIES_SPARE, LONG_SPARE
from motionkit.cli.fitting_table import print_fitting
from motionkit.lab.paper.bodies import BODIES_HEADER, MEASURES, bodies_row
from motionkit.lab.paper.long_rollouts import LONG_HEADER, long_row
from motionkit.names import counted

from .conftest import Outcome

Run = Callable[..., Outcome]


def floors(motionkit: Run, data: Path, *words: object) -> Outcome:
    """A run that takes a second."""
    options = ("--set", "all", "--data", data, "--frames", 30, "--results", "results")
    return motionkit("experiment", "run", "last frame", *options, *words)


def test_a_finished_run_is_told_by_what_it_was_made_from(motionkit: Run, paper_folder: Path) -> None:
    first = floors(motionkit, paper_folder)
    assert first.code == 0 and first.err.startswith("1 run, 0 of them done\n")
    again = floors(motionkit, paper_folder)
    assert (again.code, again.err) == (0, "1 run, 1 of them done\n")
    assert floors(motionkit, paper_folder, "--frames", 60).failed_with(
        "last-frame-0.json", "--frames 30, not 60"
    )
    (file,) = Path("results").rglob("*.json")
    file.write_text("")
    assert floors(motionkit, paper_folder).failed_with("last-frame-0.json", "delete it")
    listed = motionkit(
        "experiment", "list", "--set", "all", "--data", paper_folder, "--results", "results", "--json"
    )
    assert listed.code == 0 and "not counted: " in listed.err
    assert {row["name"]: row["done"] for row in json.loads(listed.out)}["last frame"] == 0


def test_what_cannot_be_read_or_written_is_said_first(motionkit: Run, paper_folder: Path) -> None:
    Path("results").mkdir()
    Path("results/all").write_text("")
    assert floors(motionkit, paper_folder).failed_with("results", "cannot be written", "--results")
    assert motionkit("experiment", "list", "--data", "nowhere").failed_with("nowhere: not a dataset folder")
    assert motionkit("experiment", "list").code == 0, "the default folder need not be there"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--bundled", "--model", "m.safetensors"], "--model and --bundled both name the model"),
        (["--type", "running"], "--type is for a model; give --model or --bundled"),
    ],
)
def test_options_of_in_between_that_would_do_nothing_are_refused(
    motionkit: Run, words: list[str], complaint: str
) -> None:
    Path("lafan1").mkdir()
    Path("m.safetensors").write_text("")
    said = motionkit("experiment", "in-between", "lafan1", *words)
    assert said.code == 2 and complaint in said.err and not said.out
    assert motionkit("experiment", "in-between", "lafan1").code == 1, "no options are needed"


def test_tables_and_figures_name_a_broken_result(motionkit: Run, paper_folder: Path) -> None:
    floors(motionkit, paper_folder)
    (file,) = Path("results").rglob("*.json")
    result = json.loads(file.read_text())
    del result["groups"]
    file.write_text(json.dumps(result))
    for command in ("tables", "figures"):
        said = motionkit("experiment", command, "--results", "results", "-o", "out")
        assert said.failed_with("last-frame-0.json", "groups is missing")


def rated(path: Path, scores: dict[str, tuple[int, ...]]) -> Path:
    """The answers of a rater: model to its scores in the groups."""
    answers = [
        {"group": f"g{g}", "model": model, "score": score}
        for model, given in scores.items()
        for g, score in enumerate(given)
    ]
    path.write_text(json.dumps({"format": "motionkit-study-1", "answers": answers}))
    return path


def test_a_t_test_says_what_its_samples_are(motionkit: Run, tmp_path: Path) -> None:
    one = rated(tmp_path / "one.json", {"TPTN": (4, 4, 4), "MVAE": (2, 3, 1), "flat": (3, 3, 3)})
    said = motionkit("experiment", "ttest", one)
    assert said.code == 0 and "TPTN: n 3, mean 4.000, std 0.000; 1 rater" in said.out
    (row,) = [line.split() for line in said.out.splitlines() if "MVAE" in line]
    assert [word for word in row if word != "│"][:5] == [
        "MVAE",
        "3",
        "2.000",
        "1.000",
        "3.464",
    ] and "4" in row
    assert "flat is left out: all scores of TPTN are the same" in said.err and "one rater alone" in said.err
    two = rated(tmp_path / "two.json", {"TPTN": (5, 4, 4), "MVAE": (2, 3)})
    both = motionkit("experiment", "ttest", one, two, "--json")
    facts = json.loads(both.out)
    assert (facts["n"], facts["raters"]) == (3, 2) and {
        r["model"]: r["freedom"] for r in facts["against"]
    } == {
        "MVAE": 4,
        "flat": 4,
    }
    assert (
        "answers differ in number; in the groups g0, g1, g2: MVAE 2, 2, 1; TPTN 2, 2, 2; flat 1, 1, 1"
        in both.err
    )
    assert motionkit("experiment", "ttest", one, one).failed_with("the same answers as in")


def test_the_papers_study_stands_beside_the_answers(motionkit: Run, tmp_path: Path) -> None:
    given = {"TPTN": (4, 4, 5), "MVAE": (2, 3, 1), "NeuralLayering": (3, 4, 4), "mine": (1, 2, 1)}
    file = rated(tmp_path / "one.json", given)
    facts = json.loads(motionkit("experiment", "ttest", file, "--paper", 4, "--json").out)
    beside = {row["model"]: row.get("paper") for row in facts["against"]}
    assert facts["paper"]["mean"] == 3.922 and beside["MVAE"]["t"] == 7.747 and beside["mine"] is None
    said = motionkit("experiment", "ttest", file, "--paper", 5)
    assert "in the paper: mean 3.907, std 0.407" in said.out
    (mvae,) = [line for line in said.out.splitlines() if line.startswith("MVAE")]
    (layers,) = [line for line in said.out.splitlines() if line.startswith("NeuralLayering")]
    assert "1.634e-06" in mvae and len(layers.split()) < len(mvae.split()), "table 5 has no NeuralLayering"
    facts = json.loads(motionkit("experiment", "ttest", file, "--model", "MVAE", "--paper", 4, "--json").out)
    (tptn,) = [row["paper"] for row in facts["against"] if row["model"] == "TPTN"]
    assert (tptn["mean"], tptn["t"]) == (3.922, None), "the paper holds TPTN alone against others"
    said = motionkit("experiment", "ttest", file, "--model", "MVAE", "--paper", 4)
    assert said.code == 0 and "7.747" not in said.out
    others = rated(tmp_path / "two.json", {"a": (4, 4, 5), "b": (2, 3, 1)})
    said = motionkit("experiment", "ttest", others, "--model", "a", "--paper", 4)
    assert said.code == 0 and "the paper's table 4 has none of these models" in said.err


def test_a_model_alone_has_no_t_test(motionkit: Run, tmp_path: Path) -> None:
    alone = rated(tmp_path / "alone.json", {"TPTN": (4, 3)})
    assert motionkit("experiment", "ttest", alone).failed_with("no answers about models other than TPTN")
    flat = rated(tmp_path / "flat.json", {"TPTN": (4, 4), "MVAE": (2, 2)})
    said = motionkit("experiment", "ttest", flat)
    assert said.code == 1 and "no model is left to compare TPTN with" in said.err.splitlines()[-1]


LONG_FACTS = {
    "type": "dance-salsa", "seed": 0, "distance": [4.1, 5.1, 15.4, 5.6], "distance-recorded": 7.3,
    "swing": [9.0, 11.0, 13.0, 13.0], "swing-recorded": 20.0, "speed": [103.0, 52.0, 246.0, 57.0],
    "speed-recorded": 317.0, "speed-fastest": 450.0, "holds": False,
}  # fmt: skip
BODY = {"performer": "127", **{side: dict.fromkeys(MEASURES, 76.5) for side in ("recorded", "made")}}


@pytest.mark.parametrize("columns", [60, 80, 140])
@pytest.mark.parametrize(
    ("header", "row", "spare", "missing"),
    [
        (LONG_HEADER, long_row(LONG_FACTS), LONG_SPARE, {60: 4, 80: 1}),
        (BODIES_HEADER, bodies_row(BODY), BODIES_SPARE, {60: 3}),
    ],
)
def test_tables_break_no_word_or_figure(
    columns: int,
    header: tuple[str, ...],
    row: tuple[str, ...],
    spare: tuple[int, ...],
    missing: dict[int, int],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    print_fitting(header, [row], spare)
    said = capsys.readouterr()
    shown = [i for i in range(len(header)) if i not in spare[: missing.get(columns, 0)]]
    words = sorted(word for i in shown for text in (header[i], row[i]) for word in text.split())
    found = said.out.split()
    assert all(word in found for word in words) and set(found) <= {
        w for t in (*header, *row) for w in t.split()
    }
    assert max(map(len, said.out.splitlines())) <= columns
    assert (f"left out in a terminal of {columns} columns" in said.err) == (columns in missing)


def test_one_is_no_plural() -> None:
    assert (counted(0, "run"), counted(1, "run"), counted(2, "run")) == ("0 runs", "1 run", "2 runs")
