"""`motionkit retarget`: puts the motion of one rig on another."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import (
    EXISTING,
    EXISTING_FILE,
    FILE,
    UPS,
    animation_option,
    gathered,
    given_cm,
    given_up,
    json_option,
    print_json,
    remark,
    stdout_console,
    strict_option,
    switch,
)
from motionkit.cli.finite import FiniteRange
from motionkit.cli.folders import folders
from motionkit.cli.outputs import (
    Wanted,
    animation_options,
    clip_output_option,
    read_again,
    shown_name,
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
from motionkit.errors import SkeletonError
from motionkit.names import counted
from motionkit.reading import reading

if TYPE_CHECKING:
    from rich.table import Table

    from motionkit.motion.motion import Motion
    from motionkit.rig.retarget import RetargetReport
    from motionkit.rig.rig import Rig
    from motionkit.view.figure_data import Shown

_SHOWN_OTHERS = 12  # joints without a canonical joint that are listed
_SURE = 0.9  # if any joint is less certain than this, or missing, the whole bone map is shown
_EXPECTED = ("Hips", "Neck", "Head", "Arm", "Hand", "Leg", "Foot", "ToeBase")


@dataclass(frozen=True)
class Rigs:
    """The files that describe the rigs of SOURCE and of the result, and what is taken of SOURCE."""

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

    @property
    def name(self) -> str:
        """Name of the rig, for the file name."""
        return "canonical" if self.rig_path is None else self.rig_path.stem

    def open(self) -> RigChoice:
        """Read the target rig."""
        return open_rig(self.rig_path, self.map_path, self.clip_path)

    def read(
        self, source: Path, target: Rig | None, scale: float | None
    ) -> tuple[Motion, RetargetReport, Rig | None]:
        """The motion of SOURCE, the report on it, and its rig if the options give one."""
        from motionkit.rig.on_rig import read_motion, read_on_any_rig, read_rig

        with self.reading():
            if self.source_rig is not None or self.source_map is not None:
                known = read_rig(self.source_rig or source, self.source_map)
                return (*read_motion(source, known, scale), known)
            return (*read_on_any_rig(source, target, scale), None)

    def reading(self) -> AbstractContextManager[None]:
        """Read with what the user says of SOURCE."""
        return reading(up=self.up, cm=self.unit)

    def shown(self, source: Path) -> Shown:
        """SOURCE as it is, to look at."""
        from motionkit.rig.upright import in_metres
        from motionkit.view.figure_data import Shown

        with self.reading():
            return Shown(source.stem, in_metres(read_again(source)[source]).motion)

    def save(self, rig: Rig | None, source: Path) -> list[str]:
        """Write the bone map of a rig to --save-map, by default that of SOURCE; returns the lines to print."""
        if self.save_map is None:
            return []
        from motionkit.rig.map_file import write_rig_map
        from motionkit.rig.on_rig import read_rig

        rig = rig or read_rig(source)
        write_rig_map(self.save_map, rig.skeleton, rig.joints)
        return [f"wrote {self.save_map}: bone map"]


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
    help="Write the bone map of the --rig (of SOURCE without --rig) as JSON, to edit and to give as --map.",
)
@click.option(
    "--source-rig",
    type=RIG_FILE,
    help="File that shows the rest pose of the rig of SOURCE, if SOURCE itself does not.",
)
@click.option(
    "--source-map", type=EXISTING_FILE, help="Bone map of SOURCE; found by names and shape by default."
)
@click.option("--up", type=UPS, callback=given_up, help="Axis of SOURCE that points up; found by default.")
@click.option(
    "--unit",
    callback=given_cm,
    help="Unit of SOURCE: cm, m, mm, dm, inches, or the centimetres per unit; found by default.",
)
@click.option(
    "--scale", type=FiniteRange(1e-4, 1e4), help="Centimetres per unit of SOURCE; detected by default."
)
@click.option(
    "--fps",
    type=FiniteRange(1, 480),
    help="Frame rate to write; that of SOURCE by default, or what the built-in rig's readers expect.",
)
@switch(
    "--ik/--no-ik",
    "Put the feet of the rig on the floor and hold them where those of SOURCE stand; --no-ik copies the pose.",
)
@rest_options
@animation_options
@strict_option
@view_option
@json_option
@folders("source", "output")
@gathered("rigs", Rigs)
@gathered("wanted", Wanted)
def command(
    source: Path | None, rigs: Rigs, scale: float | None, fps: float | None, ik: bool, wanted: Wanted
) -> None:
    """Write the motion of SOURCE, a clip of any human rig, on the rig of another file.

    Without --rig, the motion is written on the 23 canonical joints. Without SOURCE, the command shows how it
    understands the --rig: which joint is which, how sure that is, and what is unusual.
    """
    wanted.check()
    if source is None:
        if wanted.output is not None:
            raise click.UsageError("-o needs SOURCE, the file to retarget")
        _inspect(rigs, wanted.as_json)
        return
    choice = rigs.open()
    inputs = (source, rigs.source_rig, rigs.source_map, *choice.files)
    also = [rigs.save_map] if rigs.save_map else []
    outputs = wanted.files(f"{source.stem}-on-{rigs.name}", inputs, also=also)
    motion, report, known = rigs.read(source, choice.rig, scale)
    if fps or choice.fps:
        from motionkit.motion.motion import resample

        motion = resample(motion, fps or choice.fps or motion.fps)
    made = RootMotion(rest=rigs.rest, rest_frame=rigs.rest_frame).applied(
        choice.on_rig(motion, ik), rig=choice.rig
    )
    outputs.write(choice.clip_of(made, outputs.file.stem))
    saved = rigs.save(choice.rig or known, source)
    from motionkit.view.figure_data import Shown

    outputs.show(lambda: [rigs.shown(source), Shown(outputs.file.stem, made, character=choice.character)])
    facts = {
        "file": outputs.file,
        "frames": len(made),
        "fps": motion.fps,
        "source": {"joints": report.source_joints, "scale": report.scale, "notes": report.notes},
        "rig": None if choice.rig is None else rig_told(choice.rig),
    }
    rig = choice.rig
    on = "the canonical joints" if rig is None else f"{rig.name}, {len(rig.skeleton)} joints"
    wrote = f"wrote {shown_name(outputs.file)}: {len(made)} frames at {motion.fps:g} fps on {on}"
    if not wanted.as_json:
        for note in report.notes:
            remark(f"{source.name}: {note}")
    with rigs.reading():
        outputs.report(facts, [wrote, *(_rig_lines(rig) if rig else ()), *saved], read_again(source))


def _inspect(rigs: Rigs, as_json: bool) -> None:
    """Show the bone map of a rig, and save it if asked."""
    if rigs.rig_path is None:
        raise click.UsageError("give SOURCE, a file to retarget, or --rig, a rig to look at")
    from motionkit.files import check_outputs

    if rigs.save_map:
        check_outputs([rigs.save_map], [rigs.rig_path, rigs.map_path])
    try:
        rig = open_rig(rigs.rig_path, rigs.map_path, None).rig
        assert rig is not None
        saved = rigs.save(rig, rigs.rig_path)
    except SkeletonError:
        if rigs.save_map is None or rigs.map_path is not None:
            raise
        rig, saved = _save_exchanged(rigs.rig_path, rigs.save_map)
    if as_json:
        print_json(rig_told(rig))
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
    found = map_rig(skeleton)
    sides = {"Left": "Right", "Right": "Left"}
    exchanged = {
        next((sides[side] + name.removeprefix(side) for side in sides if name.startswith(side)), name): joint
        for name, joint in found.places.items()
    }
    write_rig_map(save_map, skeleton, replace(found, places=exchanged))
    try:
        rig = open_rig(rig_path, save_map, None).rig
    except SkeletonError:
        save_map.unlink()
        raise
    assert rig is not None
    return rig, [
        f"wrote {save_map}: bone map that exchanges left and right, which are mirrored; give it as --map"
    ]


def rig_told(rig: Rig) -> dict[str, Any]:
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
    ways = sorted({joints.found(name) for name in joints.places})
    guessed = not {"shape", "place"}.isdisjoint(ways)
    unsure = guessed or any(joints.sure(name) < _SURE for name in joints.places)
    if unsure or any(name.endswith(_EXPECTED) for name in joints.missing()):
        yield from _whole_rig(rig)
        return
    count = len(joints.places)
    missing = f"; not on this rig: {', '.join(joints.missing())}" if joints.missing() else ""
    others = len(rig.skeleton) - count
    more = f"; {counted(others, 'other joint')}" if others else ""
    yield f"{rig.name}: {count} canonical joints found by {' and '.join(ways)}{missing}{more}"
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
        more = f" and {len(others) - _SHOWN_OTHERS} more" if len(others) > _SHOWN_OTHERS else ""
        yield f"{counted(len(others), 'other joint')}: {', '.join(others[:_SHOWN_OTHERS])}{more}"
    yield from rig.notes
