"""Tables that fit the terminal: columns are omitted rather than words or numbers broken."""

from __future__ import annotations

from collections.abc import Sequence

from motionkit.cli.common import remark, stdout_console


def print_fitting(header: Sequence[str], rows: Sequence[Sequence[str]], spare: Sequence[int]) -> None:
    """Print a table that fits the terminal: words and numbers are never broken.

    Columns of `spare` are left out instead, in this order.
    """
    from rich.cells import cell_len
    from rich.table import Table

    console, kept = stdout_console(), list(range(len(header)))
    texts = [[name, *(row[i] for row in rows)] for i, name in enumerate(header)]
    least = [max(cell_len(word) for text in column for word in text.split()) for column in texts]
    room = console.width - 2 * len(header)  # two spaces after each column
    for number in spare:
        if sum(least[i] for i in kept) > room:
            kept.remove(number)
            room += 2
    widths = {i: least[i] for i in kept}
    whole = {i: max(map(cell_len, texts[i])) for i in kept}
    for _ in range(room - sum(widths.values())):  # widen the column that lacks most by one
        narrowest = max(kept, key=lambda i: whole[i] - widths[i])
        widths[narrowest] += whole[narrowest] > widths[narrowest]
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for i in kept:
        table.add_column(header[i], width=widths[i], justify="right" if i else "left", vertical="bottom")
    for row in rows:
        table.add_row(*(row[i] for i in kept))
    console.print(table)
    if len(kept) < len(header):
        left_out = ", ".join(name for i, name in enumerate(header) if i not in kept)
        remark(f"left out in a terminal of {console.width} columns: {left_out}")
