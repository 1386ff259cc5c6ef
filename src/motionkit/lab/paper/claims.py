"""What the paper says of its network against each variant, and what the results here say of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from motionkit.lab.paper.published import paper_row
from motionkit.lab.paper.tables import MAIN, Column, Figure, Results, figure_of, named, names_of
from motionkit.tables import Table

CLAIMS_HEADER = ("the paper's claim (section 5.5)", "metric", "paper", "here", "verdict")
BLIND = 0.1  # gain on the frames fed in below which a prediction is nearly the same for all; the paper has about 1


@dataclass(frozen=True)
class Claim:
    """A claim: TPTN is better than a variant by the column with this metric, or the variant moves less."""

    text: str
    rival: str
    metric: str
    less: bool = False


# Each with the metric that the paper argues from.
CLAIMS = (
    Claim("two parts move more like the recordings than the whole body", "EBTN", "bm-euler"),
    Claim("two parts move more like them than four that share the root", "FPTN-R", "bm-euler"),
    Claim("two parts move more like them than four that share the spine", "FPTN-S", "bm-euler"),
    Claim("two parts move more like them than five", "5PTN", "bm-euler"),
    Claim("the fusion layer is needed", "w/o-FFL", "bm-euler"),
    Claim("cross-attention fuses parts less well", "CrossAttn", "afs"),
    Claim("without the consistency loss bodies move less", "w/o-CL", "bm-euler", less=True),
    Claim("39 frames are too few", "TRL39", "afs"),
    Claim("135 frames smooth too much", "TRL135", "bm-euler", less=True),
    Claim("attention is better than non-local blocks", "TP-NLNN", "afs"),
    Claim("attention is better than LSTMs", "TP-LSTM4LR", "bm-euler"),
    Claim("the FK loss helps", "w/o-FK", "bm-euler"),
    Claim("oversampling of rare types helps", "w/o-OS", "bm-euler"),
    Claim("the convolutions help", "w/o-C", "bm-euler"),
    Claim("L2 losses smooth too much", "L2 Loss", "bm-euler", less=True),
    Claim("without the contact loss feet slide", "w/o-F", "afs"),
)


def claims_table(results: Results, title: str) -> Table:
    """Return the claims about the variants that one folder of results holds, with the verdict on each."""
    mine = named(results, "TPTN")
    rows = [_row(claim, mine, theirs) for claim in CLAIMS if mine and (theirs := named(results, claim.rival))]
    return Table(title, CLAIMS_HEADER, tuple(rows))


def _row(claim: Claim, mine: Results, theirs: Results) -> tuple[str, ...]:
    column = next(each for each in MAIN if each.metric == claim.metric)
    if claim.less:
        column = replace(column, goal="high")
    ours, rival = figure_of(mine, claim.metric), figure_of(theirs, claim.metric)
    truth = figure_of(mine, claim.metric, recorded=True)
    paper = [paper_row("D_L", name) for name in ("TPTN", claim.rival)]
    told = " against ".join(f"{row[column.paper]:g}" for row in paper if row is not None)
    if ours is None or rival is None:
        return (claim.text, column.title, told, "-", "cannot be measured")
    said = " against ".join(_figure(each, column.digits) for each in (ours, rival))
    return (claim.text, column.title, told, said, verdict(column, ours, rival, truth))


def _figure(figure: Figure, digits: int) -> str:
    spread = f" ± {figure.spread:.{digits}f}" if figure.seeds > 1 else ""
    return f"{figure.mean:.{digits}f}{spread}"


def verdict(column: Column, ours: Figure, rival: Figure, truth: Figure | None) -> str:
    """Return "agrees" or "does not agree" where the difference is more than twice the larger spread over seeds.

    One seed of the rival is judged by the spread of TPTN, and told; with one seed of both nothing can be said.
    """
    if max(ours.seeds, rival.seeds) < 2:
        return "cannot be said: one seed"
    gap = column.loss(rival.mean, truth) - column.loss(ours.mean, truth)
    if abs(gap) <= 2.0 * max(ours.spread, rival.spread):
        return "cannot be said: within twice the spread"
    single = ", by one seed" if min(ours.seeds, rival.seeds) < 2 else ""
    return ("agrees" if gap > 0.0 else "does not agree") + single


def blind(results: Results) -> list[str]:
    """Return the part transformers whose predicted trajectory hardly depends on the frames fed in (derivatives.py)."""
    gains = {
        name: [r["derivatives"]["features"] for r in named(results, name) if r.get("derivatives")]
        for name in names_of(results)
    }
    return [name for name, found in gains.items() if found and sum(found) / len(found) < BLIND]
