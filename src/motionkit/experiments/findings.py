"""What results say in sentences, by rule and with the spread."""

from __future__ import annotations

from motionkit.experiments.claims import BLIND, blind
from motionkit.experiments.tables import Results, figure_of, protocol_folders
from motionkit.experiments.variants import VARIANTS
from motionkit.names import counted


def findings(results: Results) -> list[str]:
    """Say of each of the paper's claims what these results say, with the spread; by rule, from the figures."""
    lines = []
    for folder in protocol_folders(results):
        here = [result for result in results if result["folder"] == folder]
        for rival, claim in (
            ("EBTN", "two parts against the whole body"),
            ("w/o-FFL", "the fusion layer"),
            ("w/o-CL", "the consistency loss"),
            ("motion matching", "the network against motion matching"),
            ("last frame", "the network against holding the last frame"),
        ):
            said = _compared(here, rival)
            if said:
                lines.append(f"`{folder}`, {claim}: {said}.")
        lines += (
            _beyond_spread(folder, here)
            + _still(folder, here)
            + _blind(folder, here)
            + _unlearnt(folder, here)
        )
    return lines or ["Nothing yet: no results of TPTN beside another."]


def by_budget(results: Results) -> list[str]:
    """Say what more training does to TPTN, for each data set with more than one budget."""
    lines = []
    mine = [r for r in results if r["name"] == "TPTN" and "budget" in r]
    for data in dict.fromkeys(r["data"] for r in mine):
        words = []
        for folder in dict.fromkeys(r["folder"] for r in mine if r["data"] == data):
            here = [r for r in mine if r["folder"] == folder]
            budget = here[0]["budget"]
            found = [
                f"{title} {each.mean:.3g} ± {each.spread:.2g}"
                if each.seeds > 1
                else f"{title} {each.mean:.3g}"
                for metric, title in (("mpjpe", "MPJPE"), ("path-mean", "path"), ("afs", "AFS"))
                if (each := figure_of(here, metric))
            ]
            seeds = counted(len(here), "seed")
            shown = f"{budget['steps']} steps of {budget['batch']} windows ({seeds})"
            words.append(f"{shown}: {', '.join(found)}")
        if len(words) > 1:
            lines.append(f"`{data}`, TPTN by training: {'; '.join(words)}.")
    return lines


def _beyond_spread(folder: str, results: Results) -> list[str]:
    """Name the other networks whose MPJPE or AFS differs from TPTN's by more than twice its spread over seeds."""
    lines = []
    names = [v.name for v in VARIANTS if v.preset and v.group != "tptn"]
    for metric, title in (("mpjpe", "MPJPE"), ("afs", "AFS")):
        mine = figure_of([r for r in results if r["name"] == "TPTN"], metric)
        if mine is None or mine.seeds < 2:
            continue
        theirs = {name: figure_of([r for r in results if r["name"] == name], metric) for name in names}
        gaps = {name: found.mean - mine.mean for name, found in theirs.items() if found is not None}
        lower, higher = (
            [name for name, gap in gaps.items() if sign * gap > 2.0 * mine.spread] for sign in (-1.0, 1.0)
        )
        single = sum(found.seeds < 2 for found in theirs.values() if found is not None)
        said = f"lower {', '.join(lower) or 'in none'}; higher {', '.join(higher) or 'in none'}"
        lines.append(
            f"`{folder}`, {title} more than twice TPTN's spread over {mine.seeds} seeds from TPTN's {mine.mean:.3g} "
            f"± {mine.spread:.2g}: {said}; of {len(gaps)} other networks, {single} with one seed."
        )
    return lines


def _still(folder: str, results: Results) -> list[str]:
    """Name the networks that hardly move, whose feet therefore hardly slide."""
    moved: dict[str, float] = {}
    for name in dict.fromkeys(r["name"] for r in results if r.get("parameters")):
        mine = [r for r in results if r["name"] == name]
        made, recorded = (figure_of(mine, "bm-euler", recorded=side) for side in (False, True))
        if made and recorded and made.mean < 0.5 * recorded.mean:
            moved[name] = made.mean / recorded.mean
    if not moved:
        return []
    shares = ", ".join(f"{name} ({share:.0%})" for name, share in moved.items())
    return [
        f"`{folder}`: these move less than half as much as the recordings, so what is low in their AFS and MPJPE is "
        f"that of bodies that stand nearly still: {shares}."
    ]


def _blind(folder: str, results: Results) -> list[str]:
    """Name the networks whose predicted trajectory hardly depends on the last frame."""
    names = blind(results)
    if not names:
        return []
    return [
        f"`{folder}`: the predicted trajectory hardly depends on the last frame fed in (mean gain below {BLIND:g} at "
        f"one test sequence; the paper gives about 1 for its whole output): {', '.join(names)}. These networks go "
        "where the trajectory that they are given goes, and do not see yet how the body moves."
    ]


def _unlearnt(folder: str, results: Results) -> list[str]:
    """Say so where the networks have not learnt enough for a comparison of what they can learn."""
    networks = [r for r in results if r.get("parameters")]
    floor = figure_of([r for r in results if r["name"] == "motion matching"], "mpjpe")
    if not networks or floor is None:
        return []
    errors = {
        name: figure_of([r for r in networks if r["name"] == name], "mpjpe")
        for name in dict.fromkeys(r["name"] for r in networks)
    }
    better = sorted(name for name, error in errors.items() if error and error.mean < floor.mean)
    if len(better) > len(errors) / 2:
        return []
    said = f"only {', '.join(better)} of {len(errors)} networks come" if better else "no network comes"
    return [
        f"`{folder}`: {said} nearer to the recordings than motion matching (MPJPE {floor.mean:.3g} cm). Differences "
        "between networks show which begin to learn sooner at this budget, not which are better when trained."
    ]


def _compared(results: Results, rival: str) -> str:
    mine = [r for r in results if r["name"] == "TPTN"]
    theirs = [r for r in results if r["name"] == rival]
    if not mine or not theirs:
        return ""
    words = []
    for metric, name in (("mpjpe", "MPJPE"), ("afs", "AFS"), ("ssim-channel", "SSIM")):
        a, b = figure_of(mine, metric), figure_of(theirs, metric)
        if a is None or b is None:
            continue
        sign = -1.0 if metric == "ssim-channel" else 1.0
        gap = sign * (b.mean - a.mean)
        fixed = rival in ("motion matching", "last frame")  # no seeds: the same every time
        seeds = a.seeds if fixed else min(a.seeds, b.seeds)
        if seeds < 2:
            verdict = "one seed, too little to say"
        elif abs(gap) <= 2.0 * max(a.spread, b.spread):
            verdict = "within twice the spread"
        else:
            verdict = "TPTN is better" if gap > 0 else f"{rival} is better"
        words.append(f"{name} {a.mean:.3g} against {b.mean:.3g} ({verdict})")
    return ", ".join(words)
