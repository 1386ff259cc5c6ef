"""What the paper says of its network against each variant, and what the results here say of it, paired by seed.

The same seed sees the same windows and draws the same random numbers, so runs are compared seed by seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from motionkit.lab.paper.tables import Results, named, number
from motionkit.lab.statistics import Paired, corrected, least_t, paired
from motionkit.names import counted
from motionkit.tables import Table

LEVEL = 0.05  # corrected p below which a difference counts


@dataclass(frozen=True)
class Measure:
    """A number of a run: its title, how a result has it, digits after the point, and whether more of it is claimed."""

    title: str
    of: Callable[[dict[str, Any]], float | None]
    digits: int
    more: bool = False


def _error(result: dict[str, Any]) -> float | None:
    """The error by block of features as a share of that of repeating the last frame, the mean over blocks."""
    blocks = result.get("held-out", {}).get("error", {})
    pairs = [(value, number(result, "held-out", "copy", block)) for block, value in blocks.items()]
    return _mean([value / copied if value is not None and copied else None for value, copied in pairs])


def _open_loop(result: dict[str, Any]) -> float | None:
    """The distance of joints in the roll-outs of a second, the mean over horizons."""
    distances = result.get("held-out", {}).get("open-loop", {}).get("mean", {})
    return _mean([value for name, value in distances.items() if name.startswith("mpjpe")])


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known and len(known) == len(values) else None


MEASURES = {
    "likelihood": Measure("negative log-likelihood per frame", lambda r: number(r, "held-out", "nll"), 1),
    "error": Measure("error one frame ahead, as a share of copying's", _error, 3),
    "open loop": Measure("joints in open loop, by mean (cm)", _open_loop, 2),
    "movement": Measure(
        "BM by mean (deg/frame)", lambda r: number(r, "by-mean", "all", "bm-euler", 0), 1, more=True
    ),
    "sliding": Measure("AFS by mean (cm/frame)", lambda r: number(r, "by-mean", "all", "afs", 0), 3),
}
BETTER = ("likelihood", "error", "open loop")
FAMILIES = (*((name,) for name in BETTER), ("movement", "sliding"))  # measures that are corrected together


@dataclass(frozen=True)
class Claim:
    """A claim, and the measures that decide it: TPTN has less of them than a variant, or more movement.

    confound is what else differs between the two, so that no difference tells.
    """

    text: str
    rival: str
    measures: tuple[str, ...] = BETTER
    confound: str = ""


CLAIMS = (
    Claim("two parts are better than the whole body", "EBTN"),
    Claim("two parts are better than four that share the root", "FPTN-R"),
    Claim("two parts are better than four that share the spine", "FPTN-S"),
    Claim("two parts are better than five", "5PTN"),
    Claim("the fusion layer is needed", "w/o-FFL"),
    Claim("cross-attention fuses parts less well", "CrossAttn"),
    Claim("without the consistency loss bodies move less", "w/o-CL", ("movement",)),
    Claim("39 frames are too few", "TRL39"),
    Claim("135 frames smooth too much", "TRL135", ("movement",)),
    Claim("attention is better than non-local blocks", "TP-NLNN"),
    Claim("attention is better than LSTMs", "TP-LSTM4LR", confound="the optimizer"),
    Claim("the FK loss helps", "w/o-FK"),
    Claim("oversampling of rare types helps", "w/o-OS"),
    Claim("the convolutions help", "w/o-C"),
    Claim("L2 losses smooth too much", "L2 Loss", ("movement",)),
    Claim("without the contact loss feet slide", "w/o-F", ("sliding",)),
)
CLAIMS_HEADER = (
    "the paper's claim (section 5.5)",
    "verdict",
    "variant",
    "seeds",
    *BETTER,
    "BM or AFS by mean",
)


@dataclass(frozen=True)
class Judged:
    """A claim by one measure: how much better TPTN is than the variant, seed by seed, and the corrected p."""

    claim: Claim
    measure: str
    found: Paired
    p: float

    @property
    def verdict(self) -> str:
        """Whether the results agree with the claim."""
        if self.p >= LEVEL:
            return "cannot be told"
        return "agrees" if self.found.mean > 0.0 else "does not agree"

    def cell(self) -> str:
        """The variant's figure minus TPTN's, t, and the corrected p."""
        measure, sign = MEASURES[self.measure], -1.0 if MEASURES[self.measure].more else 1.0
        gap, t = sign * self.found.mean, sign * self.found.t
        p = "p < 0.001" if self.p < 0.001 else f"p {self.p:.2g}"
        text = f"{gap:+.{measure.digits}f}, t {t:.1f}, {p}"
        return text if self.verdict == "cannot be told" else f"**{text}**"


def judged(results: Results) -> list[Judged]:
    """Return every claim by every measure that at least two seeds of both networks have.

    p is that of a two-sided paired t-test over seeds, corrected by Holm over the variants with the same measure.
    """
    mine = {result["seed"]: result for result in named(results, "TPTN")}
    out = []
    for names in FAMILIES:
        tests = []
        for name in names:
            measure = MEASURES[name]
            sign = -1.0 if measure.more else 1.0
            for claim in (each for each in CLAIMS if name in {*BETTER, *each.measures}):
                gaps = [
                    sign * (theirs - ours)
                    for result in named(results, claim.rival)
                    if (theirs := measure.of(result)) is not None
                    and (ours := measure.of(mine.get(result["seed"], {}))) is not None
                ]
                if len(gaps) > 1:
                    tests.append((claim, name, paired(gaps)))
        ps = corrected([found.p for *_, found in tests])
        out += [Judged(*test, p) for test, p in zip(tests, ps, strict=True)]
    return out


def verdict(claim: Claim, found: Sequence[Judged]) -> str:
    """Return the verdict on a claim by its own measures: one decides, unless another decides otherwise."""
    verdicts = {each.verdict for each in found if each.measure in claim.measures} - {"cannot be told"}
    if len(verdicts) > 1:
        return "measures differ"
    if verdicts and claim.confound:
        return f"cannot be told from {claim.confound}"
    return verdicts.pop() if verdicts else "cannot be told"


def claims_table(results: Results, title: str) -> Table:
    """Return the claims about the variants that one folder of results holds, with the verdict on each."""
    by_claim: dict[Claim, list[Judged]] = {}
    for each in judged(results):
        by_claim.setdefault(each.claim, []).append(each)
    rows = []
    for claim in CLAIMS:
        theirs = named(results, claim.rival)
        if not theirs or not named(results, "TPTN"):
            continue
        found = by_claim.get(claim, [])
        cells = {each.measure: each.cell() for each in found}
        beside = "".join(cell for name, cell in cells.items() if name not in BETTER)
        seeds = str(min((each.found.count for each in found), default=len(theirs)))
        measures = (*(cells.get(name, "") for name in BETTER), beside)
        rows.append((claim.text, verdict(claim, found), claim.rival, seeds, *measures))
    return Table(title, CLAIMS_HEADER, tuple(rows))


def counts(results: Results) -> str:
    """Say how many claims are decided, and how large t has to be for it."""
    table = claims_table(results, "")
    if not table.rows:
        return ""
    every = judged(results)
    found = [each for each in every if each.measure == BETTER[0]]
    need = ""
    if found:
        least = ", ".join(
            f"{seeds} seeds from t {least_t(LEVEL / len(found), seeds - 1):.1f}"
            for seeds in sorted({each.found.count for each in found}, reverse=True)
        )
        need = f" The first of {counted(len(found), 'variant')} is told by {least} on."
    deciding = [each for each in every if each.measure in each.claim.measures and not each.claim.confound]
    together = corrected([each.found.p for each in deciding])
    kept = {each.claim for each, p in zip(deciding, together, strict=True) if p < LEVEL}
    need += f" Corrected together over all {counted(len(deciding), 'deciding test')}, {len(kept)} claims are decided."
    verdicts = [row[1] for row in table.rows]
    decided = sum(each in ("agrees", "does not agree") for each in verdicts)
    agree = verdicts.count("agrees")
    return f"{decided} of {len(verdicts)} claims are decided: {agree} agree, {decided - agree} do not.{need}"
