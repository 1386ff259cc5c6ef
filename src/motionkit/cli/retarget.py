"""`motionkit retarget`: puts the motion of one rig on another."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import (
    EXISTING,
    EXISTING_FILE,
    FILE,
    UPS,
    animation_option,
    fps_option,
    gathered,
    json_option,
    parse_cm,
    parse_up,
    print_json,
    remark,
    stdout_console,
    strict_option,
    switch,
)
from motionkit.cli.finite import FiniteRange
from motionkit.cli.folders import folders
from motionkit.cli.outputs import (
    OutputOptions,
    animation_options,
    clip_output_option,
    display_name,
    view_option,
)
from motionkit.cli.rig_options import (
    RIG_FILE,
    RigChoice,
    RootMotion,
    clip_option,
    map_option,
    open_rig,
    rest_options,
    rig_option,
)
from motionkit.errors import SkeletonError, naming
from motionkit.names import counted
from motionkit.reading import reading

if TYPE_CHECKING:
    from rich.table import Table

    from motionkit.motion.bvh import BvhFile
    from motionkit.motion.motion import Motion
    from motionkit.rig.retarget import RetargetReport
    from motionkit.rig.rig import Rig
    from motionkit.view.figure_data import MotionView

_LISTED_OTHERS = 12  # joints without a canonical joint that are listed
_SURE = 0.9  # if any joint is less certain than this, or missing, the whole bone map is shown
_EXPECTED = ("Hips", "Neck", "Head", "Arm", "Hand", "Leg", "Foot", "ToeBase")


@dataclass(frozen=True)
class Rigs:
    """The files that describe the rigs of SOURCE and of the result, and how SOURCE is read."""

    rig_path: Path | None
    map_path: Path | None
    clip_path: Path | None
    save_map: Path | None
    source_rig: Path | None
    source_map: Path | None
    rest: str
    rest_frame: bool
    up: str | None
    unit: float | None
    scale: float | None

    @property
    def name(self) -> str:
        """Name of the rig, for the file name."""
        return "canonical" if self.rig_path is None else self.rig_path.stem

    def open(self) -> RigChoice:
        """Read the target rig."""
        return open_rig(self.rig_path, self.map_path, self.clip_path)

    def reading(self) -> AbstractContextManager[None]:
        """Read with what the user says of SOURCE; raises UsageError if that is two units."""
        if self.scale and self.unit:
            raise click.UsageError("--unit and --scale both give the unit of SOURCE; give one of them")
        return reading(up=self.up, cm=self.scale or self.unit)

    def canonical(
        self, source: Path, bvh: BvhFile, target: Rig | None
    ) -> tuple[Motion, RetargetReport, Rig | None]:
        """The canonical motion of SOURCE, the report on it, and its rig if the options give one."""
        from motionkit.rig.on_rig import canonical_for, canonical_on_floor, read_rig

        known = None
        if self.source_rig is not None or self.source_map is not None:
            known = read_rig(self.source_rig or source, self.source_map)
        with naming(source):
            return (*(canonical_on_floor(bvh, known) if known else canonical_for(bvh, target)), known)

    def source_view(self, source: Path, motion: Motion) -> MotionView:
        """The motion of SOURCE as it is, to look at."""
        from motionkit.rig.upright import in_metres
        from motionkit.view.figure_data import MotionView

        with self.reading():
            return MotionView(source.stem, in_metres(motion).motion)

    def save(self, rig: Rig | None, source: Path) -> list[str]:
        """Write the bone map of a rig to --save-map, by default that of SOURCE; returns the lines to print."""
        if self.save_map is None:
            return []
        from motionkit.rig.map_file import write_rig_map
        from motionkit.rig.on_rig import read_rig

        rig = rig or read_rig(source)
        write_rig_map(self.save_map, rig.skeleton, rig.joints)
        return [f"wrote {self.save_map}: bone map"]


def _refuse(place: Path, values: dict[str, Any]) -> None:
    """Refuse a map of each clip of a folder in one file."""
    if values["save_map"] is not None and values["rig_path"] is None:
        raise click.UsageError("--save-map for a folder needs --rig, whose map it saves")


@click.command("retarget")
@click.argument("source", required=False, type=EXISTING)
@clip_output_option("on-RIG", "SOURCE")
@rig_option
@map_option
@clip_option
@animation_option
@click.option(
    "--save-map",
    type=FILE,
    help="Write the bone map of the --rig (of SOURCE without --rig) as JSON, to edit and pass as --map.",
)
@click.option(
    "--source-rig",
    type=RIG_FILE,
    help="File that shows the rest pose of the rig of SOURCE, if SOURCE itself does not.",
)
@click.option(
    "--source-map", type=EXISTING_FILE, help="Bone map of SOURCE; found by names and shape by default."
)
@click.option("--up", type=UPS, callback=parse_up, help="Axis of SOURCE that points up; found by default.")
@click.option(
    "--unit",
    callback=parse_cm,
    help="Unit of SOURCE: cm, m, mm, dm, inches, or the centimetres per unit; found by default.",
)
@click.option(
    "--scale", type=FiniteRange(1e-4, 1e4), help="Centimetres per unit of SOURCE; detected by default."
)
@fps_option("Frame rate to write; that of SOURCE by default, or what the built-in rig's readers expect.")
@switch(
    "--ik/--no-ik",
    "Put the feet of the rig on the floor and lock them where those of SOURCE stand; --no-ik copies the pose.",
)
@rest_options
@animation_options
@strict_option
@view_option
@json_option
@folders("source", "output", refuse=_refuse)
@gathered("rigs", Rigs)
@gathered("output_options", OutputOptions)
def command(
    source: Path | None, rigs: Rigs, fps: float | None, ik: bool, output_options: OutputOptions
) -> None:
    """Write the motion of SOURCE, a clip of any human rig, on the rig of another file.

    Without --rig, the motion is written on the 23 canonical joints. Without SOURCE, the command shows how it
    understands the --rig: which joint is which, how certain that is, and what is unusual.
    """
    output_options.check()
    if source is None:
        if output_options.output is not None:
            raise click.UsageError("-o needs SOURCE, the file to retarget")
        _inspect(rigs, output_options.as_json)
        return
    choice = rigs.open()
    inputs = (source, rigs.source_rig, rigs.source_map, *choice.files)
    also = [rigs.save_map] if rigs.save_map else []
    outputs = output_options.files(f"{source.stem}-on-{rigs.name}", inputs, also=also, ending=choice.ending)
    from motionkit.motion.bvh import bvh_to_motion
    from motionkit.rig.read_file import read_file
    from motionkit.view.figure_data import MotionView

    with rigs.reading():
        bvh = read_file(source)
        motion, report, known = rigs.canonical(source, bvh, choice.rig)
    if rate := fps or choice.fps:
        from motionkit.editing.loop import at_rate

        motion = at_rate(motion, rate)
    made = RootMotion(rest=rigs.rest, rest_frame=rigs.rest_frame).applied(
        choice.on_rig(motion, ik), rig=choice.rig
    )
    outputs.write(choice.clip_of(made, outputs.file.stem))
    saved = rigs.save(choice.rig or known, source)
    in_file = bvh_to_motion(bvh)
    facts = {
        "file": outputs.file,
        "frames": len(made),
        "fps": motion.fps,
        "source": {"joints": report.source_joints, "scale": report.scale, "notes": report.notes},
        "rig": None if choice.rig is None else rig_facts(choice.rig),
    }
    rig = choice.rig
    on = "the canonical joints" if rig is None else f"{rig.name}, {len(rig.skeleton)} joints"
    wrote = f"wrote {display_name(outputs.file)}: {counted(len(made), 'frame')} at {motion.fps:g} fps on {on}"
    if not output_options.as_json:
        for note in report.notes:
            remark(f"{source.name}: {note}")
    outputs.show(
        lambda: [
            rigs.source_view(source, in_file),
            MotionView(outputs.file.stem, made, character=choice.character),
        ]
    )
    with rigs.reading():
        outputs.report(facts, [wrote, *(_rig_lines(rig) if rig else ()), *saved], (source, in_file))


def _inspect(rigs: Rigs, as_json: bool) -> None:
    """Show the bone map of a rig, and save it if asked."""
    if rigs.rig_path is None:
        raise click.UsageError("give SOURCE, a file to retarget, or --rig, a rig to look at")
    from motionkit.files import check_outputs

    if rigs.save_map:
        check_outputs([rigs.save_map], [rigs.rig_path, rigs.map_path])
    try:
        rig = open_rig(rigs.rig_path, rigs.map_path).rig
        assert rig is not None
        saved = rigs.save(rig, rigs.rig_path)
    except SkeletonError:
        if rigs.save_map is None or rigs.map_path is not None:
            raise
        rig, saved = _save_exchanged(rigs.rig_path, rigs.save_map)
    if as_json:
        print_json(rig_facts(rig))
        return
    for line in (*_whole_rig(rig), *saved):
        stdout_console().print(line)


def _save_exchanged(rig_path: Path, save_map: Path) -> tuple[Rig, list[str]]:
    """Write the map of a mirrored rig, which is read once left and right are exchanged; returns the rig and lines.

    Raises:
        SkeletonError: the rig cannot be read that way either; nothing is written.
    """
    from motionkit.rig.map_file import write_rig_map
    from motionkit.rig.names import map_rig
    from motionkit.rig.read_file import read_file

    skeleton = read_file(rig_path).skeleton
    exchanged = map_rig(skeleton).with_sides_exchanged()
    with TemporaryDirectory() as folder:  # an old map stays until the new one is known to fit
        trial = Path(folder) / save_map.name
        write_rig_map(trial, skeleton, exchanged)
        rig = open_rig(rig_path, trial).rig
    write_rig_map(save_map, skeleton, exchanged)
    assert rig is not None
    return rig, [
        f"wrote {save_map}: bone map that exchanges left and right, which are mirrored; give it as --map"
    ]


def rig_facts(rig: Rig) -> dict[str, Any]:
    """Facts about a rig for JSON: the canonical joint of each joint, and how it was found."""
    names = {joint: name for name, joint in rig.joints.places.items()}
    return {
        "file": rig.name,
        "joints": {name: names.get(joint) for joint, name in enumerate(rig.skeleton.names)},
        "found": {name: rig.joints.found(name) for name in rig.joints.places},
        "sure": {name: rig.joints.sure(name) for name in rig.joints.places},
        "sides_sure": rig.joints.sides_sure,
        "missing": list(rig.joints.missing()),
        "leg": rig.leg,
        "notes": list(rig.notes),
    }


def _rig_lines(rig: Rig) -> Iterator[str | Table]:
    """The bone map of a rig in one line; the whole map if a joint is uncertain or missing."""
    joints = rig.joints
    sources = sorted({joints.found(name) for name in joints.places})
    guessed = not {"shape", "place"}.isdisjoint(sources)
    unsure = guessed or any(joints.sure(name) < _SURE for name in joints.places)
    if unsure or any(name.endswith(_EXPECTED) for name in joints.missing()):
        yield from _whole_rig(rig)
        return
    count = len(joints.places)
    missing = f"; not on this rig: {', '.join(joints.missing())}" if joints.missing() else ""
    others = len(rig.skeleton) - count
    more = f"; {counted(others, 'other joint')}" if others else ""
    yield f"{rig.name}: {count} canonical joints found by {' and '.join(sources)}{missing}{more}"
    yield from rig.notes


def _whole_rig(rig: Rig) -> Iterator[str | Table]:
    """The whole bone map of a rig."""
    from motionkit.cli.console import make_table

    rows = []
    for name, joint in sorted(rig.joints.places.items(), key=lambda place: place[1]):
        found = rig.joints.found(name)
        sure = f"{100 * rig.joints.sure(name):.0f} %" if found in ("name", "shape") else ""
        rows.append((rig.skeleton.names[joint], name, found, sure))
    title = f"{rig.name}: {len(rig.skeleton)} joints"
    yield make_table(("joint", "canonical joint", "found by", "sure"), rows, (0, 1, 2), title=title)
    if rig.joints.missing():
        yield f"not on this rig: {', '.join(rig.joints.missing())}"
    others = [name for j, name in enumerate(rig.skeleton.names) if j not in rig.joints.places.values()]
    if others:
        more = f" and {len(others) - _LISTED_OTHERS} more" if len(others) > _LISTED_OTHERS else ""
        yield f"{counted(len(others), 'other joint')}: {', '.join(others[:_LISTED_OTHERS])}{more}"
    yield from rig.notes
