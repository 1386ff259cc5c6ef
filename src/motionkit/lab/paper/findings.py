"""What results say in sentences, by rule and with the spread."""

from __future__ import annotations

from motionkit.lab.paper.claims import MEASURES
from motionkit.lab.paper.tables import (
    Results,
    figure_at,
    figure_of,
    in_folder,
    named,
    names_of,
    protocol_folders,
)
from motionkit.lab.statistics import figure
from motionkit.names import counted

CERTAIN = 0.02  # difference of BM drawn and by mean, as a share, below which a network draws its mean


def findings(results: Results) -> list[str]:
    """Say what these results say of all networks together; by rule, from the figures."""
    lines = []
    for folder in protocol_folders(results):
        here = in_folder(results, folder)
        for rival, claim in (
            ("motion matching", "the network against motion matching"),
            ("last frame", "the network against holding the last frame"),
        ):
            finding = _compared(here, rival)
            if finding:
                lines.append(f"`{folder}`, {claim}: {finding}.")
        lines += _copying(folder, here) + _still(folder, here) + _unlearnt(folder, here)
    return lines or ["Nothing yet: no results of TPTN beside another."]


def by_budget(results: Results) -> list[str]:
    """Say what more training does to TPTN, for each data set with more than one budget."""
    lines = []
    mine = [r for r in named(results, "TPTN") if "budget" in r]
    for data in dict.fromkeys(r["data"] for r in mine):
        words = []
        for folder in dict.fromkeys(r["folder"] for r in mine if r["data"] == data):
            here = in_folder(mine, folder)
            budget = here[0]["budget"]
            found = [
                f"{title} {each.mean:.3g} ± {each.spread:.2g}"
                if each.seeds > 1
                else f"{title} {each.mean:.3g}"
                for metric, title in (("mpjpe", "MPJPE"), ("path-mean", "path"), ("afs", "AFS"))
                if (each := figure_of(here, metric))
            ]
            seeds = counted(len(here), "seed")
            budget_text = f"{budget['steps']} steps of {budget['batch']} windows ({seeds})"
            words.append(f"{budget_text}: {', '.join(found)}")
        if len(words) > 1:
            lines.append(f"`{data}`, TPTN by training: {'; '.join(words)}.")
    return lines


def _copying(folder: str, results: Results) -> list[str]:
    """Name the networks whose error one frame ahead is that of repeating the last frame, or more."""
    error = MEASURES["error"]
    shares = {
        name: found.mean
        for name in names_of(results)
        if (found := figure([s for r in named(results, name) if (s := error.of(r)) is not None]))
    }
    worse = ", ".join(f"{name} ({share:.2f})" for name, share in shares.items() if share >= 1.0)
    if not shares:
        return []
    return [
        f"`{folder}`, {error.title}: {worse or 'no network'} at or above 1; {sum(s < 1.0 for s in shares.values())} of "
        f"{len(shares)} networks below."
    ]


def _still(folder: str, results: Results) -> list[str]:
    """Name the networks that hardly move by mean, and those whose drawn frames are the mean."""
    moved: dict[str, float] = {}
    certain: list[str] = []
    trained = names_of([r for r in results if r.get("parameters")])
    for name in trained:
        mine = named(results, name)
        drawn, recorded = (figure_of(mine, "bm-euler", recorded=side) for side in (False, True))
        made = figure_at(mine, "by-mean", "all", "bm-euler", 0)
        if made and drawn and recorded:
            if made.mean < 0.5 * recorded.mean:
                moved[name] = made.mean / recorded.mean
            if abs(made.mean / drawn.mean - 1.0) < CERTAIN:
                certain.append(name)
    if not moved:
        return []
    ordered = sorted(moved, key=lambda name: moved[name])
    shares = [f"{name} ({moved[name]:.0%})" for name in ordered]
    # The least and the most of many are enough.
    words = ", ".join(shares) if len(shares) < len(trained) / 2 else f"{shares[0]} to {shares[-1]}"
    lines = [
        f"`{folder}`: by mean, {len(moved)} of {counted(len(trained), 'network')} move less than half as much as the "
        f"recordings: {words}."
    ]
    figures = [figure_at(named(results, "TPTN"), "by-mean", "all", metric, 0) for metric in ("mpjpe", "afs")]
    if certain and all(figures):
        mpjpe, afs = (each.mean for each in figures if each)
        lines.append(
            f"`{folder}`: {', '.join(certain)} draw their mean, without sigma; TPTN by mean compares with them: MPJPE "
            f"{mpjpe:.3g}, AFS {afs:.3g}."
        )
    return lines


def _unlearnt(folder: str, results: Results) -> list[str]:
    """Say so where the networks have not learnt enough for a comparison of what they can learn."""
    networks = [r for r in results if r.get("parameters")]
    floor = figure_of(named(results, "motion matching"), "mpjpe")
    if not networks or floor is None:
        return []
    errors = {name: figure_of(named(networks, name), "mpjpe") for name in names_of(networks)}
    better = sorted(name for name, error in errors.items() if error and error.mean < floor.mean)
    if len(better) > len(errors) / 2:
        return []
    count = f"only {', '.join(better)} of {len(errors)} networks come" if better else "no network comes"
    return [
        f"`{folder}`: {count} nearer to the recordings than motion matching (MPJPE {floor.mean:.3g} cm). Differences "
        "between networks show which begin to learn sooner at this budget, not which are better when trained."
    ]


def _compared(results: Results, rival: str) -> str:
    mine = named(results, "TPTN")
    theirs = named(results, rival)
    if not mine or not theirs:
        return ""
    words = []
    for metric, name in (("mpjpe", "MPJPE"), ("afs", "AFS"), ("ssim-channel", "SSIM")):
        a, b = figure_of(mine, metric), figure_of(theirs, metric)
        if a is None or b is None:
            continue
        sign = -1.0 if metric == "ssim-channel" else 1.0
        gap = sign * (b.mean - a.mean)
        if a.seeds < 2:  # the rival is the same every time
            verdict = "one seed, too little to say"
        elif abs(gap) <= 2.0 * a.spread:
            verdict = "within twice the spread"
        else:
            verdict = "TPTN is better" if gap > 0 else f"{rival} is better"
        words.append(f"{name} {a.mean:.3g} against {b.mean:.3g} ({verdict})")
    return ", ".join(words)
