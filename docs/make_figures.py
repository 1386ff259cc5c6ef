"""Writes the figures of the docs into docs/figures, from the bundled model and the clips of examples/data.

python docs/make_figures.py [NAME...]     # needs matplotlib, which is in the extra "notebook"
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from figure_style import (
    FAINT,
    GREEN,
    INK,
    LEFT,
    PINK,
    RIGHT,
    SOFT,
    VIOLET,
    arrow,
    box,
    draw_body,
    new_figure,
    plain,
    save,
)

import motionkit as mk
from motionkit.arrays import Array
from motionkit.control.character_start import last_poses
from motionkit.control.follow import PathFollower
from motionkit.control.plan import plan_path
from motionkit.control.reference_player import ReferencePlayer
from motionkit.features.control import TRAJECTORY_OFFSETS
from motionkit.features.layout import FEATURE_COUNT, feature_layout
from motionkit.features.reference import REFERENCE_OFFSETS
from motionkit.inference.start import type_start
from motionkit.inference.stepping import stepper
from motionkit.metrics.value import MetricSettings
from motionkit.models.model import MotionModel
from motionkit.models.parts import PARTITIONS
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS

DATA = Path(__file__).resolve().parents[1] / "examples" / "data"
CARTWHEEL = "49_06.bvh"
SECONDS_PER_CM = 0.0032  # across, of poses over a time axis, which makes them as wide as they are high
STANDING = 3.5  # cm, the floor that feet are measured from: the height of standing toes
FRONT, SIDE = [0, 1], [2, 1]  # columns of joint positions that a picture shows across and up


def recording(name: str) -> mk.Motion:
    """A sample clip on the canonical joints at 60 fps."""
    return mk.resample(mk.read_canonical(DATA / name), 60)


def loop(model: MotionModel) -> Any:
    """1: a frame goes in, the next comes out and goes in again."""
    figure, axes = new_figure(2.5)
    axes.set(xlim=(-0.3, 12.6), ylim=(0.1, 4.3))
    plain(axes)
    boxes = (
        (1.2, 3.3, "controls\ntype, trajectory,\nphase, reference pose", (2.8, 1.3), GREEN),
        (1.2, 1.3, "frame\n276 numbers,\n4 contacts", (2.8, 1.3), SOFT),
        (4.5, 2.3, "network\n12 layers, last\n87 frames", (2.2, 1.5), INK),
        (7.4, 2.3, "Gaussian\nmean and σ of\nthe next frame", (2.2, 1.5), SOFT),
        (10.8, 3.3, "pose\nheight, foot locking,\njoints in the world", (3.1, 1.3), PINK),
        (10.8, 1.3, "sample, blend,\nroot follows\nstanding feet", (3.1, 1.3), VIOLET),
    )
    for x, y, text, size, color in boxes:
        box(axes, x, y, text, size, color)
    arrow(axes, (2.65, 3.2), (3.35, 2.7))
    arrow(axes, (2.65, 1.4), (3.35, 1.9))
    arrow(axes, (5.65, 2.3), (6.25, 2.3))
    arrow(axes, (8.55, 2.0), (9.2, 1.6))
    arrow(axes, (10.8, 2.0), (10.8, 2.6))
    arrow(axes, (9.2, 0.95), (2.65, 0.95), VIOLET)
    axes.text(6.0, 0.45, "the next frame is the next input", color=VIOLET, ha="center")
    return figure


def rigs(model: MotionModel) -> Any:
    """2: a recorded rig, and the 23 canonical joints."""
    figure, (left, right) = new_figure(3.2, 1, 2)
    raw = mk.read_bvh(DATA / CARTWHEEL)
    rest, parents = raw.skeleton.rest_positions() * 2.54 / 0.45, raw.skeleton.parents
    draw_body(left, rest[:, FRONT], skeleton=raw.skeleton)
    left.scatter(*rest[:, :2].T, s=9, color=INK, zorder=3)
    left.set_title(f"a file's rig: {len(parents)} joints")
    skeleton = mk.canonical_skeleton()
    body = skeleton.rest_positions()
    draw_body(right, body[:, FRONT])
    right.scatter(*body[:, :2].T, s=9, color=INK, zorder=3)
    right.set_title(f"the canonical joints: {len(body)}")
    for name, shift in (("Head", (6, 0)), ("Hips", (9, 3)), ("LeftForeArm", (0, 6)), ("RightLeg", (-8, 0))):
        x, y = body[JOINT_NAMES.index(name)][:2]
        right.text(x + shift[0], y + shift[1], name, ha="right" if shift[0] < 0 else "left", color=SOFT)
    for axes in (left, right):
        plain(axes)
        axes.set(xlim=(-95, 95), ylim=(-105, 70))
    return figure


def features(model: MotionModel) -> Any:
    """3: the 276 numbers of a cartwheel."""
    motion = recording(CARTWHEEL)
    encoded = mk.encode(motion, model.reference_rotations)
    values = np.clip(model.scaling.normalize(encoded.features), -3, 3)
    figure, (top, below) = new_figure(4.6, 2, 1, height_ratios=(1, 2.6), sharex=True)
    seconds = len(motion) / motion.fps
    places = mk.kinematics(motion)[1]
    for frame in np.linspace(4, len(motion) - 5, 13).astype(int):
        body = places[frame][:, SIDE] - [places[frame, 0, 2], 0]
        draw_body(top, body * [SECONDS_PER_CM, 1.0], at=frame / motion.fps, width=1.2)
    top.set_ylim(-5, 205)
    plain(top, equal=False)
    below.imshow(
        values.T,
        aspect="auto",
        cmap="PuOr",
        interpolation="nearest",
        extent=(0, seconds, FEATURE_COUNT, 0),
        vmin=-3,
        vmax=3,
    )
    blocks = feature_layout(model.config.layout).blocks
    for name, columns in blocks.items():
        below.axhline(columns.start, color=SOFT, lw=0.5)
        if columns.stop - columns.start > 9:
            middle = (columns.start + columns.stop) / 2
            below.text(-0.05, middle, name.replace("_", "\n"), ha="right", va="center")
    below.text(-0.05, 3, "root", ha="right", va="center")
    below.set(xlabel="seconds", yticks=[])
    return figure


def rotations(model: MotionModel) -> Any:
    """4: the root's rotation through a cartwheel in both layouts."""
    figure, axes = new_figure(2.4, 1, 2, sharex=True)
    motion = recording(CARTWHEEL)
    titles = {"expmap-root-1": "exponential map", "sixd-root-1": "two columns of the matrix"}
    for one, (layout, title) in zip(axes, titles.items(), strict=True):
        block = feature_layout(layout).blocks["root_rotation"]
        values = mk.encode(motion, layout=layout).features[:, block]
        time = np.arange(len(values)) / 60
        for column in range(values.shape[1]):
            one.plot(time, values[:, column], color=(LEFT, RIGHT, GREEN, PINK, VIOLET, SOFT)[column])
        step = np.linalg.norm(np.diff(values, axis=0), axis=1)
        at = int(step.argmax())
        one.axvline(time[at], color=FAINT, lw=5, zorder=0)
        one.set(title=f"{title}: largest step {step[at]:.2f}", xlabel="seconds")
    return figure


def parts(model: MotionModel) -> Any:
    """5: two parts that share the root."""
    figure, (left, right) = new_figure(2.8, 1, 2, width_ratios=(1, 2.1))
    body = mk.canonical_skeleton().rest_positions()
    upper, lower = (set(part.joints) for part in PARTITIONS[model.config.variant.partition].parts)
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            ends = body[[parent, joint]][:, :2]
            left.plot(*ends.T, color=LEFT if joint in upper else RIGHT, lw=3, solid_capstyle="round")
    left.scatter(*body[0, :2], s=90, color=VIOLET, zorder=3)
    left.text(10, 2, "root", color=VIOLET)
    left.text(-88, 62, f"upper: {len(upper)} joints", color=LEFT)
    left.text(-88, -100, f"lower: {len(lower)} joints,\n4 contacts", color=RIGHT, va="top")
    plain(left)
    left.set(xlim=(-95, 95), ylim=(-125, 75))
    right.set(xlim=(0, 10.6), ylim=(0.2, 4.0))
    plain(right)
    layers, size = model.config.layers, (2.2, 1.1)
    for y, color, name in ((3.1, LEFT, "upper"), (1.1, RIGHT, "lower")):
        box(right, 1.2, y, f"{name}\nshallow\n{layers} layers", size, color)
        box(right, 5.6, y, f"{name}\ndeep\n{layers} layers", size, color)
        arrow(right, (2.35, y), (4.45, y), color)
        arrow(right, (6.75, y), (7.6, 2.3 if y > 2 else 1.9), color)
    arrow(right, (2.35, 2.8), (4.45, 1.4), LEFT)
    arrow(right, (2.35, 1.4), (4.45, 2.8), RIGHT)
    right.text(3.4, 3.3, "fusion", ha="center", color=SOFT)
    box(right, 9.0, 2.1, "aggregation\nmean, σ, trajectory", (2.9, 1.0), INK)
    right.text(9.0, 1.15, "contacts from the\nlower parts", ha="center", color=SOFT, va="top")
    return figure


def memory(model: MotionModel) -> Any:
    """6: how long a change of one frame is felt."""
    figure, (left, right) = new_figure(2.5, 1, 2, width_ratios=(1, 1.5))
    config = model.config
    reach = [config.kernel + (config.window - 1) * layer for layer in range(2 * config.layers + 1)]
    left.barh(range(len(reach)), reach, color=LEFT, height=0.7)
    left.set(xlabel="frames seen", ylabel="layer", title=f"{config.window} frames a layer", yticks=(0, 6, 12))
    left.text(reach[-1], len(reach) - 1, f"{reach[-1]} ", ha="right", va="center", color="white")
    encoded = mk.encode(recording("35_30.bvh"), model.reference_rotations)
    x = model.scaling.normalize(encoded.features).astype(np.float32)
    contacts = encoded.contacts.astype(np.float32)
    controls = np.zeros((2, model.controls.size), np.float32)
    controls[:, model.controls.type.start + model.type_id("walking")] = 1.0
    step = stepper(model.network, 2)
    changed, felt = 12, []
    for frame in range(changed + 100):
        rows = x[[frame, frame]]
        if frame == changed:
            rows = np.stack([rows[0], rows[0] + np.float32(0.5)])
        step.step(rows, contacts[[frame, frame]], controls)
        if frame >= changed:
            felt.append(float(np.sqrt(np.square(step.mean[0] - step.mean[1]).mean())))
    last = max(index for index, value in enumerate(felt) if value > 0)
    right.semilogy(range(last + 1), felt[: last + 1], color=PINK)
    right.axvspan(last + 1, len(felt), color=FAINT)
    right.text(last - 1, felt[1], f"nothing from\nframe {last + 1} on", va="top", ha="right")
    right.set(
        xlabel="frames after the changed one",
        title="change of the prediction (RMS, deviations)",
        xlim=(0, 99),
    )
    return figure


def reference_poses(model: MotionModel) -> Any:
    """7: what a dance is shown, and what it does."""
    kind, frames = "dance-salsa", 240
    stream = mk.CharacterStream(model, seed=3)
    stream.reset(0, type=kind)
    player = ReferencePlayer(model, choice=1)
    player.begin(kind, last_poses(model, type_start(model, kind).features[0]))
    shown, made = [], []
    for _ in range(frames):
        controls = player.play(1)
        assert player.clip is not None
        shown.append(player.clip.poses[player.at - 1 + np.array((0, *REFERENCE_OFFSETS))])
        made.append(stream.step(controls))
    positions = np.stack([frame.positions[0] for frame in made])
    features = np.stack([in_heading(frame.positions[0], frame.ground[0]) for frame in made])
    told_at = [poses_of(each, model) for each in shown]
    figure, (top, below) = new_figure(4.7, 2, 1, height_ratios=(1.7, 1))
    at = 96
    spacing = 135.0
    for number, ahead in enumerate((0, *REFERENCE_OFFSETS)):
        draw_body(top, told_at[at][number][:, FRONT], number * spacing, SOFT, 4.5, 0.45)
        body = features[at + ahead]
        draw_body(top, body[:, FRONT], number * spacing, None, 1.6)
        label = "now" if not ahead else f"{ahead} frames ahead"
        top.text(number * spacing, 186, label, ha="center")
    plain(top)
    top.set(ylim=(-4, 198))
    time = np.arange(frames) / 60
    hand = JOINT_NAMES.index("RightHand")
    below.plot(
        time,
        [each[0][hand, 1] for each in told_at],
        color=SOFT,
        lw=4,
        alpha=0.5,
        label="recording, from 24 numbers",
    )
    below.plot(time, positions[:, hand, 1], color=RIGHT, label="made")
    below.axvline(at / 60, color=FAINT, lw=4, zorder=0)
    below.set(xlabel="seconds", ylabel="right hand, cm", ylim=(85, None))
    below.legend(loc="upper right", ncols=2)
    return figure


def in_heading(places: Array, ground: Array) -> Array:
    """Joints (23, 3) in the heading frame of ground: x, z and heading."""
    turned = places - [ground[0], 0.0, ground[1]]
    sine, cosine = np.sin(ground[2]), np.cos(ground[2])
    x, z = turned[:, 0] * cosine - turned[:, 2] * sine, turned[:, 0] * sine + turned[:, 2] * cosine
    return np.stack([x, turned[:, 1], z], axis=1)


def poses_of(embeddings: Array, model: MotionModel) -> Array:
    """Joint positions (N, 23, 3) in the heading frame that embeddings (N, 24) leave likely: those nearest the mean."""
    matrix, mean = model.pose_embedding.matrix.astype(np.float64), model.scaling.mean.astype(np.float64)
    values = mean + (embeddings + model.pose_embedding.offset - mean @ matrix) @ np.linalg.pinv(matrix)
    places = np.zeros((len(values), len(JOINT_NAMES), 3))
    for index, column in enumerate(feature_layout(model.config.layout).columns):
        if column.block == "joint_positions":
            places[:, column.joint, column.component] = values[:, index]
    return places


def noise(model: MotionModel) -> Any:
    """8: three ways to draw frames."""
    figure, axes = new_figure(2.3, 1, 3, sharey=True)
    kinds = {"mean": mk.Noise("mean"), "sample": mk.Noise("sample", 1.0), "correlated": mk.Noise()}
    hand = JOINT_NAMES.index("LeftHand")
    for one, (name, drawn) in zip(axes, kinds.items(), strict=True):
        jerks = []
        for seed in range(4):
            motion = mk.synthesize("idle:4", model=model, seed=seed, noise=drawn).motion
            places = mk.kinematics(motion)[1]
            one.plot(np.arange(len(places)) / 60, places[:, hand, 0] - places[:, 0, 0], lw=0.9)
            for line, color in zip(one.lines, (LEFT, RIGHT, GREEN, PINK), strict=False):
                line.set_color(color)
            jerks.append(mk.measure(motion).value("jerk"))
        one.set(title=f"{name}: jerk {np.mean(jerks):.0f} m/s³", xlabel="seconds")
    axes[0].set_ylabel("left hand from the hips, cm")
    return figure


def feet(model: MotionModel) -> Any:
    """9: a foot as it is drawn, and held."""
    figure, (left, right) = new_figure(2.7, 1, 2, width_ratios=(1.7, 1))
    free = model.with_types(
        {name: {"preset": replace(kind.preset, slip_correction=0.0)} for name, kind in model.types.items()}
    )
    kinds, slid = ("dance-salsa", "martial-arts", "walking"), []
    for kind in kinds:
        ways = ((free, False), (model, False), (model, True))
        made = [
            [mk.synthesize(f"{kind}:8", model=m, seed=seed, ik=ik).motion for seed in (0, 1)]
            for m, ik in ways
        ]
        slid.append([np.mean([sliding(motion) for motion in each]) for each in made])
        if kind == kinds[0]:
            raw, held = (each[0] for each in made[1:])
    toe = JOINT_NAMES.index("RightToeBase")
    for motion, color, label, width in ((raw, PINK, "as drawn", 1.2), (held, GREEN, "held", 1.6)):
        places = mk.kinematics(motion)[1][:300, toe]
        speed = np.linalg.norm(np.diff(places[:, [0, 2]], axis=0), axis=1) * 60
        left.plot(np.arange(len(speed)) / 60, speed, color=color, lw=width, label=label)
    left.set(title="speed of the right toe in a salsa, cm/s", xlabel="seconds", ylim=(0, 240))
    left.legend(loc="upper left", ncols=2)
    labels = ("uncorrected", "root-slip correction", "feet held")
    for number, (label, color) in enumerate(zip(labels, (SOFT, PINK, GREEN), strict=True)):
        right.barh(
            np.arange(3) + (number - 1) * 0.27,
            [each[number] for each in slid],
            0.25,
            color=color,
            label=label,
        )
    right.set(title="foot sliding (afs), cm a frame", yticks=range(3), yticklabels=kinds)
    right.set_ylim(3.4, -0.5)
    right.legend(loc="lower left", fontsize=7.5, ncols=2, columnspacing=0.8, handlelength=1)
    return figure


def sliding(motion: mk.Motion) -> float:
    """Foot sliding in cm a frame, above one floor for all."""
    return mk.measure(motion, settings=MetricSettings(floor=STANDING)).value("afs")


def steering(model: MotionModel) -> Any:
    """10: a path, and live wishes."""
    figure, (left, right) = new_figure(2.9, 1, 2, width_ratios=(1, 1.25))
    path = mk.shape_path("figure-eight", 2.0, ["walking"], None)
    made = mk.follow_path(path, model=model, seed=0).motion
    track = made.root_positions[:, [0, 2]]
    line = np.concatenate([part.points for part in path.parts])
    left.plot(*line.T, color=FAINT, lw=5)
    left.plot(*track.T, color=LEFT, lw=1.2)
    follower, at = PathFollower(model, plan_path(model, path)), 90
    x, z = track[at]
    heading = float(np.arctan2(*(track[at + 1] - track[at - 1])))
    ahead = np.asarray(follower(at, np.array([[x, z, heading]])).trajectory).reshape(-1)[:12].reshape(6, 2)
    sine, cosine = np.sin(heading), np.cos(heading)
    left.scatter(x + ahead @ (cosine, sine), z + ahead @ (-sine, cosine), s=22, color=RIGHT, zorder=3)
    left.scatter(x, z, s=40, color=INK, zorder=3)
    left.set_title(f"the root, and its places in {TRAJECTORY_OFFSETS[0]} to {TRAJECTORY_OFFSETS[-1]} frames")
    plain(left)
    stream, driver = mk.CharacterStream(model, seed=0), mk.Driver(model)
    wishes = {0: 0.0, 60: 130.0, 240: 320.0, 420: 60.0, 540: 0.0}
    speeds, asked, before = [], [], stream.ground[0, :2].copy()
    for frame in range(660):
        if frame in wishes:
            driver.set_wish(mk.Wish(velocity=(0.0, wishes[frame])))
            wish = wishes[frame]
        stream.step(driver(frame, stream.ground))
        speeds.append(float(np.linalg.norm(stream.ground[0, :2] - before)) * 60)
        before, _ = stream.ground[0, :2].copy(), asked.append(wish)
    time = np.arange(660) / 60
    smooth = np.convolve(speeds, np.ones(15) / 15, "same")
    right.step(time, asked, color=SOFT, where="post", label="wished")
    right.plot(time, smooth, color=LEFT, label="shown")
    right.set(title="speed over the ground, cm/s", xlabel="seconds")
    right.legend(loc="upper right")
    return figure


def data_flow(model: MotionModel) -> Any:
    """What flows between the rooms of the code, for docs/architecture.md."""
    figure, axes = new_figure(3.3)
    axes.set(xlim=(-0.2, 14.2), ylim=(-0.5, 6.4))
    plain(axes)
    things = {
        "files": (1.2, 5.6, "BVH, GLB,\nVRM files", SOFT),
        "motion": (4.6, 5.6, "Motion", LEFT),
        "dataset": (8.0, 5.6, "dataset\nfolder", SOFT),
        "model": (11.6, 5.6, "model file", GREEN),
        "asked": (1.2, 3.4, "types, path\nor wishes", SOFT),
        "controls": (4.6, 3.4, "Controls", LEFT),
        "inference": (8.0, 3.4, "inference", VIOLET),
        "engine": (11.6, 3.4, "ONNX graph,\npage with the model", SOFT),
        "clients": (1.2, 1.0, "browser,\nengine", SOFT),
        "made": (4.6, 1.0, "Motion", LEFT),
        "out": (8.3, 1.0, "BVH, glTF,\nVRMA, USD, tables", SOFT),
        "shown": (11.9, 1.0, "metrics, scoreboard,\npages, films", SOFT),
    }
    for x, y, text, color in things.values():
        box(axes, x, y, text, (2.4 + 0.45 * (len(text) > 22), 1.0), color)
    flows = (
        ("files", "motion", "motion"),
        ("motion", "dataset", "data"),
        ("dataset", "model", "training"),
        ("model", "engine", "export, play"),
        ("model", "inference", ""),
        ("asked", "controls", "control"),
        ("controls", "inference", ""),
        ("inference", "made", ""),
        ("made", "clients", "play"),
        ("made", "out", "export"),
    )
    for start, end, room in flows:
        (x, y), (u, v) = things[start][:2], things[end][:2]
        if y == v:
            side = 1.4 if u > x else -1.4
            arrow(axes, (x + side, y), (u - side, v))
            axes.text((x + u) / 2, y + 0.12, room, ha="center", va="bottom", color=SOFT, fontsize=7.5)
        elif x == u:
            arrow(axes, (x, y - 0.6), (u, v + 0.6))
            axes.text(x + 0.15, (y + v) / 2, room, va="center", color=SOFT, fontsize=7.5)
        else:
            arrow(axes, (x - 1.1, y - 0.6), (u + 1.1, v + 0.6))
    arrow(axes, (5.2, 0.4), (11.0, 0.4), bend=0.1)
    axes.text(8.1, -0.35, "lab, view", ha="center", color=SOFT, fontsize=7.5)
    axes.text(9.3, 2.55, "each frame is the next input", ha="center", color=VIOLET, fontsize=7.5)
    return figure


OTHERS = {"data-flow": data_flow}
FIGURES = {
    "1-loop": loop,
    "2-rigs": rigs,
    "3-features": features,
    "4-rotations": rotations,
    "5-parts": parts,
    "6-memory": memory,
    "7-references": reference_poses,
    "8-noise": noise,
    "9-feet": feet,
    "10-steering": steering,
}


def main(names: list[str]) -> None:
    """Write all figures, or the named ones."""
    model = mk.load_model()
    every = FIGURES | OTHERS
    for name in names or every:
        path = save(every[name](model), name)
        print(f"{path.name}: {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
