"""`motionkit retarget`: motion of one rig on another."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motionkit.cli.common import default_output, json_option, print_json, remark, say, stdout_console
from motionkit.cli.finite import FiniteRange
from motionkit.cli.rig_options import clip_option, map_option, open_rig, rig_option
from motionkit.cli.showing import view_option, write_and_open
from motionkit.cli.synthesis_options import (
    STDOUT,
    check_stdout,
    output_option,
    shown_name,
    words_console,
    write_motion,
)
from motionkit.names import counted

if TYPE_CHECKING:
    from motionkit.rig.retarget import RetargetReport
    from motionkit.rig.rig import Rig

_SHOWN_OTHERS = 12  # joints without a canonical joint that are named
_SURE = 0.9  # below this, or without one of these joints, a conversion shows the whole bone map
_EXPECTED = ("Hips", "Neck", "Head", "Arm", "Hand", "Leg", "Foot", "ToeBase")


@click.command("retarget")
@click.argument("source", required=False, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@output_option("File to write; named after SOURCE and the rig by default")
@rig_option
@map_option
@clip_option
@click.option(
    "--save-map",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the bone map of the --rig (of SOURCE without --rig) as JSON, to edit and to give as --map.",
)
@click.option(
    "--source-rig",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="File that shows the rest pose of the rig of SOURCE, if SOURCE itself does not.",
)
@click.option(
    "--source-map",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Bone map of SOURCE; found by names and shape by default.",
)
@click.option(
    "--scale",
    type=FiniteRange(1e-4, 1e4),
    help="Centimetres per unit of SOURCE; detected by default.",
)
@click.option("--fps", type=FiniteRange(1, 480), help="Frame rate to write; that of SOURCE by default.")
@click.option(
    "--ik/--no-ik",
    default=True,
    show_default=True,
    help="Put the feet of the rig on the floor and hold them where those of SOURCE stand; --no-ik copies the pose.",
)
@view_option
@json_option
def command(
    source: Path | None,
    output: Path | None,
    rig_path: Path | None,
    map_path: Path | None,
    clip_path: Path | None,
    save_map: Path | None,
    source_rig: Path | None,
    source_map: Path | None,
    scale: float | None,
    fps: float | None,
    ik: bool,
    view: bool,
    as_json: bool,
) -> None:
    """Write the motion of SOURCE, a BVH file of any human rig, on the rig of another file.

    Without --rig, the motion is written on the 23 canonical joints. Without SOURCE, the command shows how it
    understands the --rig: which joint is which, how sure that is, and what is unusual.
    """
    from motionkit.files import check_outputs

    check_stdout(output, {"--view": view, "--json": as_json})
    if source is None:
        if output is not None:
            raise click.UsageError("-o needs SOURCE, the BVH file to retarget")
        _inspect(rig_path, map_path, save_map, as_json)
        return
    choice = open_rig(rig_path, map_path, clip_path)
    stem = "canonical" if rig_path is None else rig_path.stem
    file = output or default_output(f"{source.stem}-on-{stem}")
    page_file = [file.with_suffix(".html")] if view else []
    written = ([] if file == STDOUT else [file]) + page_file + ([save_map] if save_map else [])
    check_outputs(written, (source, source_rig, source_map, *choice.files))
    motion, report, known = _read(source, source_rig, source_map, choice.rig, scale)
    if fps is not None:
        from motionkit.motion.motion import resample

        motion = resample(motion, fps)
    made = choice.put(motion, ik)
    write_motion(file, made, choice=choice)
    if save_map:
        _save_map(save_map, choice.rig or known, source)
    page = None
    if view:
        from motionkit.motion.bvh import bvh_to_motion, read_bvh
        from motionkit.view.figure_data import Shown

        shown = [Shown(source.stem, bvh_to_motion(read_bvh(source))), Shown(file.stem, made)]
        page = write_and_open(page_file[0], shown, as_json)
    if as_json:
        result: dict[str, Any] = {
            "file": str(file),
            "frames": len(motion),
            "fps": motion.fps,
            "source": {"joints": report.source_joints, "scale": report.scale, "notes": list(report.notes)},
            "rig": None if choice.rig is None else rig_told(choice.rig),
        }
        print_json(result | ({"view": str(page)} if page else {}))
        return
    out = words_console(output)
    on = (
        "the canonical joints"
        if choice.rig is None
        else f"{choice.rig.name}, {len(choice.rig.skeleton)} joints"
    )
    out.print(f"wrote {shown_name(file)}: {len(motion)} frames at {motion.fps:g} fps on {on}")
    for note in report.notes:
        remark(f"{source.name}: {note}")
    if choice.rig is not None:
        _tell_rig(choice.rig, stdout_console() if output != STDOUT else out)
    if save_map:
        out.print(f"wrote {save_map}: bone map")
    if page:
        out.print(f"wrote {page}")


def _read(
    source: Path, source_rig: Path | None, source_map: Path | None, target: Rig | None, scale: float | None
) -> tuple[Any, RetargetReport, Rig | None]:
    """The motion of SOURCE, what was found in it, and its rig where that had to be studied."""
    from motionkit.rig.on_rig import read_motion, read_on_any_rig, read_rig

    if source_rig is not None or source_map is not None:
        known = read_rig(source_rig or source, source_map)
        return (*read_motion(source, known, scale), known)
    return (*read_on_any_rig(source, target, scale), None)


def _save_map(path: Path, rig: Rig | None, source: Path) -> None:
    from motionkit.rig.map_file import write_rig_map
    from motionkit.rig.on_rig import read_rig

    rig = rig or read_rig(source)
    write_rig_map(path, rig.skeleton, rig.joints)


def _inspect(rig_path: Path | None, map_path: Path | None, save_map: Path | None, as_json: bool) -> None:
    """Show, and save, the bone map of a rig."""
    if rig_path is None:
        raise click.UsageError("give SOURCE, a BVH file to retarget, or --rig, a rig to look at")
    from motionkit.files import check_outputs

    if save_map:
        check_outputs([save_map], [rig_path, map_path])
    rig = open_rig(rig_path, map_path, None).rig
    assert rig is not None
    if save_map:
        _save_map(save_map, rig, rig_path)
    if as_json:
        print_json(rig_told(rig))
        return
    _print_rig(rig, stdout_console())
    if save_map:
        say(f"wrote {save_map}: bone map")


def rig_told(rig: Rig) -> dict[str, Any]:
    """A rig for programs: its joints with their canonical joints, and how they were found."""
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


def _tell_rig(rig: Rig, out: Any) -> None:
    """Print the bone map of a rig in one line, or whole if a joint is unsure or missing."""
    joints = rig.joints
    ways = sorted({joints.found(name) for name in joints.places})
    unsure = any(joints.sure(name) < _SURE for name in joints.places) or not {"shape", "place"}.isdisjoint(
        ways
    )
    if unsure or any(name.endswith(_EXPECTED) for name in joints.missing()):
        _print_rig(rig, out)
        return
    count = len(joints.places)
    missing = f"; not on this rig: {', '.join(joints.missing())}" if joints.missing() else ""
    others = len(rig.skeleton) - count
    more = f"; {counted(others, 'other joint')}" if others else ""
    out.print(f"{rig.name}: {count} canonical joints found by {' and '.join(ways)}{missing}{more}")
    for note in rig.notes:
        out.print(note)


def _print_rig(rig: Rig, out: Any) -> None:
    """Print the bone map of a rig."""
    from rich.table import Table

    table = Table(title=f"{rig.name}: {len(rig.skeleton)} joints")
    for name in ("joint", "canonical joint", "found by", "sure"):
        table.add_column(name, justify="right" if name == "sure" else "left")
    for name, joint in sorted(rig.joints.places.items(), key=lambda place: place[1]):
        found = rig.joints.found(name)
        sure = f"{100 * rig.joints.sure(name):.0f} %" if found in ("name", "shape") else ""
        table.add_row(rig.skeleton.names[joint], name, found, sure)
    out.print(table)
    if rig.joints.missing():
        out.print(f"not on this rig: {', '.join(rig.joints.missing())}")
    others = [name for j, name in enumerate(rig.skeleton.names) if j not in rig.joints.places.values()]
    if others:
        more = f" and {len(others) - _SHOWN_OTHERS} more" if len(others) > _SHOWN_OTHERS else ""
        out.print(f"{counted(len(others), 'other joint')}: {', '.join(others[:_SHOWN_OTHERS])}{more}")
    for note in rig.notes:
        out.print(note)
