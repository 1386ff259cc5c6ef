"""Writes the table of exporters of docs/sources.md: what is taken of a file of each, and what is noted.

python docs/make_sources.py FILES.csv, a table with the columns exporter, file and picture: what a person saw on the
contact sheet of the file. Files are not named on the page. Exporters of which there is nothing to say are printed, for
the list above the table.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

from motionkit.errors import MotionkitError
from motionkit.reading import reading
from motionkit.rig.names import EXCHANGED
from motionkit.rig.pose import map_file
from motionkit.rig.read_file import read_file
from motionkit.rig.retarget import retarget
from motionkit.rig.units import unit_symbol
from motionkit.tables import Table

PAGE = Path(__file__).with_name("sources.md")
BEGIN, END = "<!-- exporters -->", "<!-- end of exporters -->"


def row(exporter: str, file: str, picture: str) -> tuple[str, ...]:
    """A row of the table."""
    told: list[str] = []
    try:
        with reading(on_note=told.append):
            bvh = read_file(file)
            report = retarget(bvh)[1]
            joints = map_file(bvh)
    except MotionkitError as error:
        said = str(error).removeprefix(f"{file}: ")
        return exporter, "", "", "", f"refused: {said}", picture
    up = next((note.split()[2] for note in report.notes if note.startswith("up axis ")), "+Y")
    ways = " and ".join(sorted({joints.found(name) for name in joints.places}))
    lacks = f"; no {', '.join(report.missing)}" if report.missing else ""
    noted = [note.partition("read with ")[2] for note in told]
    noted += (
        ["the rest pose is not standing"] if any("not a standing" in note for note in report.notes) else []
    )
    noted += [note for note in report.notes if note == EXCHANGED]
    return exporter, unit_symbol(report.scale), up, f"{ways}{lacks}", "; ".join(noted), picture


def main() -> None:
    with Path(sys.argv[1]).open(newline="") as file:
        rows = [row(each["exporter"], each["file"], each["picture"]) for each in csv.DictReader(file)]
    plain = [each for each in rows if not each[4] and each[5] == "right"]
    print(*(", ".join(each[:4]) for each in plain), sep="\n")
    rows = [each for each in rows if each not in plain]
    columns = ("exporter", "unit", "up", "joints found by", "noted", "picture")
    lines = Table("", columns, rows).markdown()
    page = PAGE.read_text("utf-8")
    head, rest = page.split(BEGIN)
    tail = rest.split(END)[1]
    PAGE.write_text(f"{head}{BEGIN}\n{chr(10).join(lines)}\n{END}{tail}", "utf-8")


if __name__ == "__main__":
    main()
