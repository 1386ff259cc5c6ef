"""Results as tables, in Markdown and LaTeX, the paper's figure beside ours. Nothing is trained here."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from motionkit.data.dataset import MIRRORED
from motionkit.lab.paper.datasets import SELECTIONS
from motionkit.lab.paper.protocol import means
from motionkit.lab.paper.published import BODY_MOVEMENT, BY_DATA_SET
from motionkit.lab.paper.shipped import GROUP
from motionkit.lab.paper.variants import VARIANTS, Variant
from motionkit.lab.statistics import Figure, figure
from motionkit.names import counted
from motionkit.tables import Table

Results = Sequence[dict[str, Any]]
NumberColumn = tuple[
    str, tuple[str, ...], int
]  # title of a column, path to its number in a result, digits after the point


@dataclass(frozen=True)
class Column:
    """A column of figures.

    Attributes:
        goal: "truth" if the best value is nearest to the recorded one, "low" or "high".
        paper: place in the paper's rows, -1 for none.
    """

    metric: str
    title: str
    goal: str
    digits: int
    paper: int = -1

    def loss(self, value: float, truth: Figure | None) -> float:
        """Return how bad a value is; truth is the recorded one."""
        if self.goal == "truth":
            return abs(value - truth.mean) if truth else math.inf
        return value if self.goal == "low" else -value


MAIN = (
    Column("bm-euler", "BM (deg/frame)", "truth", 1, 0),
    Column("afs", "AFS (cm/frame)", "low", 3, 1),
    Column("ssim-channel", "SSIM", "high", 3, 2),
    Column("mpjpe", "MPJPE (cm)", "low", 2, 3),
    Column("path-mean", "path (cm/frame)", "low", 2),
)
RESEARCH = (
    Column("l2p", "L2P (cm)", "low", 1),
    Column("l2q", "L2Q", "low", 3),
    Column("npss", "NPSS", "low", 3),
    Column("skate-ratio", "foot skate", "low", 3),
    Column("jerk", "jerk (m/s³)", "truth", 0),
)
# Whether a network performs what its control input says: EBTN, asked to twist, does not (section 5.5).
CLASSIFIED_AS = Column("class-accuracy", "taken for its type", "high", 2)
PARTS_MOVED = (
    Column("bm-upper", "BM of the upper body", "truth", 1),
    Column("bm-lower", "BM of the lower body", "truth", 1),
)
GROUP_TITLES = {
    "parts": "Body parts (paper table 6)",
    "fusion": "Feature fusion and consistency loss (paper table 7)",
    "memory": "Receptive field and backbone (paper table 8)",
    "losses": "Losses and data (paper table 9)",
    "baselines": "Networks of other papers, and floors (paper tables 1 to 3)",
}


def named(results: Results, name: str) -> list[dict[str, Any]]:
    """Return the results of a variant."""
    return [result for result in results if result["name"] == name]


def in_folder(results: Results, folder: str) -> list[dict[str, Any]]:
    """Return the results of a data set and budget."""
    return [result for result in results if result["folder"] == folder]


def names_of(results: Results) -> list[str]:
    """Return the names of variants in results, in their order."""
    return list(dict.fromkeys(result["name"] for result in results))


def number(result: dict[str, Any], *path: str | int) -> float | None:
    """Return the number at a path of keys and places in a result; None where it has none."""
    value: Any = result
    for key in path:
        if value is None:
            return None
        value = value.get(key) if isinstance(value, dict) else value[key]
    return value


def figure_at(results: Results, *path: str | int) -> Figure | None:
    """Return the figure of the numbers at a path over results of one variant; None where no run has one."""
    return figure([float(value) for result in results if (value := number(result, *path)) is not None])


def figure_of(results: Results, metric: str, group: str = "all", recorded: bool = False) -> Figure | None:
    """Return a metric's figure over results of one variant; None where no run has it."""
    return figure_at(results, "groups", group, metric, int(recorded))


def clear_best(figures: dict[str, Figure], column: Column, truth: Figure | None) -> str | None:
    """Return which network is best by more than the spread over seeds; None if none is or the seeds are too few."""

    def loss(figure: Figure) -> float:
        return column.loss(figure.mean, truth)

    ranked = sorted(figures, key=lambda name: loss(figures[name]))
    if len(ranked) < 2:
        return None
    first, second = figures[ranked[0]], figures[ranked[1]]
    if min(first.seeds, second.seeds) < 2:
        return None
    return ranked[0] if loss(second) - loss(first) > max(first.spread, second.spread) else None


def tables(results: Results) -> list[Table]:
    """Return all tables: for each data set and budget the groups of variants, beside TPTN."""
    out = []
    for folder in protocol_folders(results):
        out += _folder_tables(folder, in_folder(results, folder))
    return out + _shipped_tables(results)


def protocol_folders(results: Results) -> list[str]:
    """Return the folders of results that follow the protocol: all but those of the shipped model."""
    return sorted({result["folder"] for result in results if result["group"] != GROUP})


def _shipped_tables(results: Results) -> list[Table]:
    """The shipped model beside each folder's networks, all on the sequences it has not seen."""
    out = []
    for folder in protocol_folders(results):
        here = in_folder(results, folder)
        selection, longest = here[0]["data"], here[0]["longest"]
        shipped = [r for r in results if (r["group"], r["data"], r["longest"]) == (GROUP, selection, longest)]
        if not shipped:
            continue
        names = {_recording(row) for row in shipped[0]["sequences"]}
        by_name: dict[str, list[dict[str, Any]]] = defaultdict(list)
        for each in (*shipped, *here):
            kept = _of_names(each, names)
            if kept and each["group"] in (GROUP, "tptn", "baselines", "floors"):
                by_name[each["name"]].append(each | {"groups": {"all": means(kept)}})
        bundled = [Variant(name, GROUP, "") for name in names_of(shipped)]
        members = [*bundled, *(v for v in VARIANTS if v.name in by_name)]
        title = f"The shipped model as shipped, on {len(names)} recordings it has not seen: {_named(folder)}"
        out.append(_table(title, "", members, by_name, MAIN))
    return out


def _of_names(result: dict[str, Any], names: set[str]) -> list[dict]:
    """The rows of these recordings, nothing if some are missing."""
    rows = [row for row in result["sequences"] if _recording(row) in names]
    return rows if len(rows) == len(names) else []


def _recording(row: dict[str, Any]) -> str:
    """The recording of a test sequence, whatever folder it lay in."""
    return str(row["sequence"]).rpartition("/")[2]


def _folder_tables(folder: str, results: Results) -> list[Table]:
    by_name = {name: named(results, name) for name in names_of(results)}
    selection = results[0]["data"]
    out = []
    for group, title in GROUP_TITLES.items():
        members = [
            v
            for v in VARIANTS
            if v.name == "TPTN"
            or v.group == group
            or (group == "baselines" and v.group in ("tptn", "floors"))
        ]
        present = [v for v in members if v.name in by_name]
        if not any(v.group != "tptn" for v in present):
            continue
        columns = (*MAIN, *PARTS_MOVED) if group == "fusion" else MAIN
        # The paper has variants of its network on the small data set alone.
        paper_set = selection if selection == "D_L" or group == "baselines" else ""
        if not paper_set:
            title = title.partition(" (")[0]
        out.append(_table(f"{title}: {_named(folder)}", paper_set, present, by_name, columns))
        if group == "baselines":
            for part in ("non-dance", "dance"):
                if any(part in r["groups"] for r in results) and any("dance" in r["groups"] for r in results):
                    out.append(
                        # The paper's figures are of all sequences.
                        _table(f"{title}, {part}: {_named(folder)}", "", present, by_name, MAIN, part)
                    )
            out.append(
                _table(f"Metrics of other papers: {_named(folder)}", selection, present, by_name, RESEARCH)
            )
            names = [v.name for v in present]
            out.append(_distribution(f"Sets of motions: {_named(folder)}", names, by_name))
    for name in ("TPTN", "EBTN"):
        out.append(_by_type(f"{name} by type of motion: {_named(folder)}", by_name.get(name, [])))
    names = [v.name for v in VARIANTS if v.name in by_name]
    out += _held_out_tables(_named(folder), names, by_name)
    with_gains = [name for name in names if figure_at(by_name[name], *GAINS[0][1])]
    out.append(
        _plain(f"Derivatives of the predicted trajectory: {_named(folder)}", GAINS, with_gains, by_name)
    )
    return [table for table in out if table.rows]


def _named(folder: str) -> str:
    selection, _, budget = folder.partition("/")
    return f"{selection}, budget {budget}"


def _table(
    title: str,
    selection: str,
    variants: Sequence[Variant],
    by_name: dict[str, list[dict[str, Any]]],
    columns: tuple[Column, ...],
    part: str = "all",
) -> Table:
    truths = {c.metric: figure_of(by_name[variants[0].name], c.metric, part, recorded=True) for c in columns}
    found = {
        c.metric: {v.name: f for v in variants if (f := figure_of(by_name[v.name], c.metric, part))}
        for c in columns
    }
    columns = tuple(c for c in columns if found[c.metric] or truths[c.metric])  # measured by any run
    best = {c.metric: clear_best(found[c.metric], c, truths[c.metric]) for c in columns}
    rows = [("recorded", "", "", *(_recorded_cell(truths[c.metric], c, selection) for c in columns))]
    for v in variants:
        cells = []
        for c in columns:
            text = _cell(found[c.metric].get(v.name), c.digits)
            text = f"**{text}**" if best[c.metric] == v.name else text
            cells.append(_beside(text, _paper_value(selection, v.name, c)))
        rows.append((v.name, str(len(by_name[v.name])), _parameters(v, by_name[v.name]), *cells))
    return Table(title, ("", "seeds", "parameters (M)", *(c.title for c in columns)), tuple(rows))


def _by_type(title: str, results: Results) -> Table:
    """The main figures of one variant for each type of motion, the recorded ones in brackets."""
    kinds = sorted({row["type"] for result in results for row in result["sequences"] if "type" in row})
    by_kind = [
        result
        | {
            "groups": {
                k: means(rows) for k in kinds if (rows := [r for r in result["sequences"] if r["type"] == k])
            }
        }
        for result in results
    ]
    columns = (*MAIN, CLASSIFIED_AS) if figure_of(results, CLASSIFIED_AS.metric) else MAIN
    rows = []
    for kind in kinds:
        frames = sum(row["frames"] for row in results[0]["sequences"] if row["type"] == kind)
        made = [figure_of(by_kind, column.metric, kind) for column in columns]
        truth = [figure_of(by_kind, column.metric, kind, recorded=True) for column in columns]
        cells = [
            _beside(_cell(value, column.digits), "" if real is None else round(real.mean, column.digits))
            for column, value, real in zip(columns, made, truth, strict=True)
        ]
        rows.append((kind, str(frames), *cells))
    return Table(title, ("", "frames", *(column.title for column in columns)), tuple(rows))


def _paper_value(selection: str, name: str, column: Column) -> float | str:
    if column in PARTS_MOVED:
        pair = BODY_MOVEMENT.get(name) if selection == "D_L" else None
        return "" if pair is None else pair[PARTS_MOVED.index(column)]
    row = BY_DATA_SET.get(selection, {}).get(name)
    return "" if row is None or column.paper < 0 else row[column.paper]


def _recorded_cell(figure: Figure | None, column: Column, selection: str) -> str:
    # Recordings are the same for every seed.
    alone = None if figure is None else replace(figure, seeds=1)
    return _beside(_cell(alone, column.digits), _paper_value(selection, "recorded", column))


def _cell(figure: Figure | None, digits: int) -> str:
    if figure is None:
        return "-"
    spread = f" ± {figure.spread:.{digits}f}" if figure.seeds > 1 and figure.spread > 0.0 else ""
    return f"{figure.mean:.{digits}f}{spread}"


def _beside(ours: str, paper: float | str) -> str:
    return f"{ours} ({paper:g})" if isinstance(paper, float) else ours


def _parameters(v: Variant, results: Results) -> str:
    ours = f"{results[0]['parameters'] / 1e6:.2f}" if results[0]["parameters"] else "-"
    return ours if v.paper_parameters is None else f"{ours} ({v.paper_parameters:g})"


def _plain(
    title: str,
    columns: Sequence[NumberColumn],
    names: Sequence[str],
    by_name: dict[str, list[dict[str, Any]]],
    above: Sequence[tuple[str, ...]] = (),
    seeds: bool = False,
) -> Table:
    """A table of numbers as they are in results: a row for each network, below those that are given."""
    rows = [
        (
            name,
            *([str(len(by_name[name]))] if seeds else []),
            *(_cell(figure_at(by_name[name], *path), digits) for _, path, digits in columns),
        )
        for name in names
    ]
    heads = ("", *(["seeds"] if seeds else []), *(head for head, _, _ in columns))
    return Table(title, heads, (*above, *rows))


OF_SETS: tuple[NumberColumn, ...] = (
    ("Frechet distance (fid-pose)", ("distribution", "fid-pose"), 2),
    ("diversity", ("distribution", "diversity"), 2),
    ("accuracy of a classifier (class-accuracy)", ("distribution", "class-accuracy"), 3),
    ("Frechet distance of its features (fid-class)", ("distribution", "fid-class"), 2),
)


def _distribution(title: str, names: Sequence[str], by_name: dict[str, list[dict[str, Any]]]) -> Table:
    columns = [of for of in OF_SETS if any(figure_at(by_name[name], *of[1]) for name in names)]
    recorded = {"fid-pose": "0.00", "fid-class": "0.00", "class-accuracy": "-"}
    recorded["diversity"] = _cell(figure_at(by_name[names[0]][:1], "distribution", "diversity-gt"), 2)
    above = ("recorded", *(recorded[path[-1]] for _, path, _ in columns))
    return _plain(title, columns, names, by_name, [above])


AHEAD: tuple[NumberColumn, ...] = (
    ("likelihood", ("held-out", "nll"), 1),
    ("trajectory's likelihood", ("held-out", "nll-trajectory"), 1),
    *(
        (name, ("held-out", "error", name), 3)
        for name in ("rotations", "positions", "velocities", "root", "trajectory")
    ),
)
OPEN_LOOP: tuple[NumberColumn, ...] = (
    *(
        (f"joints, {name} s (cm)", ("held-out", "open-loop", "mean", f"mpjpe-{name}"), 2)
        for name in ("0.25", "0.5", "1")
    ),
    ("root, 1 s (cm)", ("held-out", "open-loop", "mean", "root-1"), 2),
    ("joints of a sample, 1 s (cm)", ("held-out", "open-loop", "sample", "mpjpe-1"), 2),
    ("BM by mean (deg/frame)", ("held-out", "bm", "mean"), 1),
    ("BM of a sample (deg/frame)", ("held-out", "bm", "sample"), 1),
)


def _held_out_tables(
    named_folder: str, names: Sequence[str], by_name: dict[str, list[dict[str, Any]]]
) -> list[Table]:
    """Errors one frame ahead and in open loop, on the same windows and from the same frames for all networks."""
    members = [name for name in names if any("held-out" in r for r in by_name[name])]
    if not members:
        return []
    one = [next(r for r in by_name[members[0]] if "held-out" in r)]
    copied = [
        (
            name,
            "",
            *(_cell(figure_at(one, "held-out", method, path[-1]), digits) for _, path, digits in AHEAD),
        )
        for name, method in (("repeated", "copy"), ("going on", "extrapolation"))
    ]
    moved = _cell(figure_at(one, "held-out", "bm", "recorded"), 1)
    recorded = ("recorded", "", *(moved if "bm" in path else "" for _, path, _ in OPEN_LOOP))
    return [
        _plain(f"{title}: {named_folder}", columns, members, by_name, above, seeds=True)
        for title, columns, above in (
            ("One frame ahead, on held-out clips", AHEAD, copied),
            ("A second in open loop, from held-out frames", OPEN_LOOP, [recorded]),
        )
    ]


GAINS: tuple[NumberColumn, ...] = (
    ("by the trajectory fed in", ("derivatives", "trajectory"), 2),
    ("by the features fed in", ("derivatives", "features"), 2),
)


def budget_lines(results: Results) -> list[str]:
    """Say in a line per folder what its runs were given, and how many there are."""
    lines = []
    for folder in protocol_folders(results):
        here = in_folder(results, folder)
        trained = [r for r in here if "budget" in r]
        known = SELECTIONS.get(here[0]["data"])
        text = next(
            (r["text"] for r in here if "text" in r), known.text if known else "a data set of its own"
        )
        line = f"**{_named(folder)}**: {text}; {counted(len(here), 'result')}."
        if trained:
            b = trained[0]["budget"]
            line += (
                f" Each network: {b['steps']} steps of {b['batch']} windows of {b['window']} frames, "
                f"rate {b['rate']:g}; {_minutes(trained)}."
            )
            if b.get("config"):
                words = ", ".join(f"{option} {value:g}" for option, value in b["config"].items())
                line += f" Part transformers differ from the paper's in {words}, because training is short."
        most = f"At most {here[0]['longest']} frames are made of a sequence."
        lines.append(f"{line} {_test_set(here)} {most} {_command(here, folder)}")
    return lines


def _minutes(trained: Results) -> str:
    """Say how many runs each machine made, and the minutes of the shortest and the longest."""
    seconds: dict[str, list[float]] = {}
    for each in trained:
        seconds.setdefault(each["timing"]["machine"], []).append(each["timing"]["seconds"])
    parts = []
    for machine, found in seconds.items():
        least, most = (round(each / 60.0) for each in (min(found), max(found)))
        span = ("" if least == most else f"{least} to ") + counted(most, "minute")
        parts.append(f"{counted(len(found), 'run')} of {span} on {machine}")
    return ", ".join(parts)


def _test_set(here: Results) -> str:
    """Say what a folder's runs were tested on, and how far recordings differ that were prepared at different times."""
    rows = here[0]["sequences"]
    mirrored = sum(row["sequence"].endswith(MIRRORED) for row in rows)
    frames = sum(row["frames"] for row in rows)
    text = f"Tested on {len(rows)} sequences, {frames:,} frames"
    text += f", {mirrored} of them mirror images of training clips." if mirrored else "."
    moved = {round(each.mean, 2) for r in here if (each := figure_of([r], "bm-euler", recorded=True))}
    if len(moved) > 1:
        least, most = min(moved), max(moved)
        text += (
            " The recordings were prepared at different times by changing code, so that the recorded BM of these "
            f"results goes from {least:.2f} to {most:.2f}."
        )
    return text


def _command(here: list[dict[str, Any]], folder: str) -> str:
    """How the runs of a folder are made again, in words."""
    budget, _, steps = folder.partition("/")[2].partition("-")
    words = f"--set {here[0]['data']} --budget {budget} --frames {here[0]['longest']}"
    needed = {variant.name: variant.seeds for variant in VARIANTS}
    more = any(result["seed"] >= needed.get(result["name"], 1) for result in here)
    seeds = max([3, *(result["seed"] + 1 for result in here)])
    return (
        f"Command: `motionkit experiment run all {words}{f' --steps {steps}' if steps else ''} --seeds {seeds}"
        f"{' --every-seed' if more else ''}`."
    )


def missing(results: Results, folder: str) -> list[str]:
    """Return the variants, with how many runs, that a folder still lacks."""
    here = in_folder(results, folder)
    budget = folder.partition("/")[2].partition("-")[0]
    lacking = [
        (v.name, v.seeds - len({result["seed"] for result in named(here, v.name)}))
        for v in VARIANTS
        if v.runs_at(budget)
    ]
    return [f"{name} ({count})" if count > 1 else name for name, count in lacking if count > 0]


def markdown(table: Table) -> str:
    """Return a table in Markdown, below its title."""
    return "\n".join([f"### {table.title}", "", *table.markdown()]) + "\n"


def latex(table: Table) -> str:
    """Return a table in LaTeX (booktabs)."""

    def cell(text: str) -> str:
        if text.startswith("**"):
            inner, _, rest = text[2:].partition("**")
            text = f"\\textbf{{{inner}}}{rest}"
        for sign, code in (("±", "$\\pm$"), ("³", "$^3$"), ("_", "\\_"), ("%", "\\%")):
            text = text.replace(sign, code)
        return text

    rows = [" & ".join(map(cell, row)) + r" \\" for row in table.texts()]
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\begin{{tabular}}{{l{'c' * (len(table.columns) - 1)}}}",
        r"\toprule",
        " & ".join(map(cell, table.columns)) + r" \\",
        r"\midrule",
        *rows,
        r"\bottomrule",
        r"\end{tabular}",
        rf"\caption{{{cell(table.title)}}}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"
