"""The one table of what is compared: the paper's network, its variants, baselines from other papers, and floors.

Architectures that are entry points and have no line here are compared too, under their own names.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from motionkit.errors import MotionkitError
from motionkit.features.control import ControlLayout
from motionkit.models.architectures import build, plugged_in
from motionkit.models.network import parameter_count
from motionkit.models.presets import preset

GROUPS = ("tptn", "parts", "fusion", "memory", "losses", "baselines", "floors")


@dataclass(frozen=True)
class Variant:
    """Something that predicts motion, and how it is trained.

    Attributes:
        preset: the preset or architecture it changes; "" for floors, which are not trained.
        config: fields of the network's config that differ from the preset.
        options: options of training that differ from the paper's.
        paper_parameters: as the paper gives them, in millions.
        seeds: how many runs it is to have.
        budgets: those at which it differs from the others; () for all.
    """

    name: str
    group: str
    text: str
    preset: str = "tptn-paper"
    config: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)
    paper_parameters: float | None = None
    seeds: int = 3
    budgets: tuple[str, ...] = ()

    @property
    def learns_contacts(self) -> bool:
        """Whether training has a contact loss; else contact outputs are random numbers, which are not fed back."""
        return self.options.get("weights", {}).get("contact", 1.0) > 0.0

    def runs_at(self, budget: str) -> bool:
        """Whether there is something to run at a budget."""
        return not self.budgets or budget in self.budgets


def _weights(**changes: float) -> dict[str, Any]:
    """Training options with other weights of the losses than the paper's."""
    weights = {"gauss": 1.0, "smooth": 10.0, "contact": 5.0, "fk": 5.0, "consistency": 1.0, "trajectory": 1.0}
    return {"weights": weights | changes}


# Widths are chosen so that the numbers of parameters come near the paper's, which gives no sizes.
_FOUR = {"width": 88, "ffn": 163, "control_width": 24, "control_embedding": 24, "shared_channels": 16}
_NO_SIGMA = {"log_sigma_min": -9.2, "log_sigma_max": -9.2}  # drawn frames are the mean

_TRAINED: tuple[Variant, ...] = (
    Variant("TPTN", "tptn", "the paper's network", paper_parameters=3.59),
    Variant("absolute head", "tptn", "TPTN with the paper's head and dropout, where a budget changes them",
            config={"head_leak": 0.0, "head_momentum": False, "input_dropout": 0.5, "deep_dropout": 0.5},
            paper_parameters=3.59,
            budgets=("short", "medium", "long")),
    Variant(
        "EBTN", "parts", "one stream for the whole body",
        config={"partition": "one", "width": 176, "ffn": 314}, paper_parameters=3.1,
    ),
    Variant(
        "FPTN-R", "parts", "four parts that share the root",
        config={"partition": "four-root", **_FOUR}, paper_parameters=3.37,
    ),
    Variant(
        "FPTN-S", "parts", "four parts that share the spine",
        config={"partition": "four-spine", **_FOUR, "shared_channels": 40}, paper_parameters=3.38,
    ),
    Variant(
        "5PTN", "parts", "two arms, two legs and the spine",
        config={"partition": "five", **_FOUR, "width": 80, "ffn": 137}, paper_parameters=3.4,
    ),
    Variant("w/o-FFL", "fusion", "no fusion between the parts", config={"fusion": "none"}),
    Variant("CrossAttn", "fusion", "cross-attention for fusion", config={"fusion": "cross-attention"}),
    Variant("w/o-CL", "fusion", "no consistency loss", config={"consistency": False}),
    Variant("TRL39", "memory", "layers see 4 frames", config={"window": 4}),
    Variant("TRL135", "memory", "layers see 12 frames", config={"window": 12}),
    Variant("TP-NLNN", "memory", "causal non-local residual blocks", config={"backbone": "non-local"}),
    Variant("TP-LSTM4LR", "memory", "four-layer LSTMs", config={"backbone": "lstm"}),
    Variant("w/o-FK", "losses", "no FK loss", options=_weights(fk=0.0)),
    Variant("w/o-OS", "losses", "no oversampling of rare types", options={"balance": 0.0}),
    Variant("w/o-C", "losses", "convolutions over one frame", config={"kernel": 1}),
    Variant("L2 Loss", "losses", "squared errors for the Gaussian loss", "tptn-paper",
            config=_NO_SIGMA, options={"likelihood": "l2"}),
    Variant(
        "w/o-F", "losses", "no contact loss, and no foot slip in the FK loss",
        options={**_weights(contact=0.0), "slip_weight": 0.0},
    ),
    Variant("PFNN", "baselines", "phase-functioned network (Holden 2017)", "pfnn"),
    Variant("MVAE", "baselines", "motion VAE (Ling 2020) with controls, no policy", "mvae", paper_parameters=2.03),
    Variant("HTSS", "baselines", "hierarchical two-stream GRUs (Ghosh 2021)", "htss", paper_parameters=4.7),
    Variant("NeuralLayering", "baselines", "reconstruction of Starke 2021, whose code is not public", "neural-layering",
            paper_parameters=25.21),
    Variant("LearnedMM", "baselines", "learned motion matching (Holden 2020): decompressor, stepper, projector",
            "learned-motion-matching"),
)  # fmt: skip
_FLOORS = (
    Variant("last frame", "floors", "the last initial frame, held", "", seeds=1),
    Variant("nearest clip", "floors", "the training clip whose half second before is nearest", "", seeds=1),
    Variant("motion matching", "floors", "recorded frames, searched every third of a second", "", seeds=1),
)
_NAMED = {each.preset for each in _TRAINED}
_PLUGGED_IN = tuple(
    Variant(name, "baselines", "an architecture of an entry point, in its own sizes", name)
    for name in plugged_in()
    if name not in _NAMED
)
VARIANTS = (*_TRAINED, *_PLUGGED_IN, *_FLOORS)


def variant(name: str) -> Variant:
    """Return a variant by name, upper and lower case alike. Raises MotionkitError if it is unknown."""
    for each in VARIANTS:
        if each.name.lower() == name.lower():
            return each
    raise MotionkitError(
        f"unknown experiment {name!r}, expected one of {', '.join(v.name for v in VARIANTS)}"
    )


def parameters(each: Variant, types: int = 21) -> int:
    """Return the number of parameters of a variant's network for so many motion types (the paper's 21)."""
    if not each.preset:
        return 0
    config = preset(each.preset, **each.config)
    layout = ControlLayout(tuple(map(str, range(types))), config.controls)
    return parameter_count(build(config, layout.size))


def chosen(words: tuple[str, ...]) -> list[Variant]:
    """Return the variants that names, groups and "all" stand for, in the order of the table."""
    names: set[str] = set()
    for word in words:
        if word == "all":
            names |= {each.name for each in VARIANTS}
        elif word in GROUPS:
            names |= {each.name for each in VARIANTS if each.group == word}
        else:
            names.add(variant(word).name)
    return [each for each in VARIANTS if each.name in names]
