"""Tables and lengths for the terminal."""

from collections.abc import Collection, Sequence


def columns(rows: Sequence[Sequence[str]], text: Collection[int] = (0,), indent: str = "  ") -> list[str]:
    """Format rows in aligned columns: those in `text` to the left, the others, numbers, to the right.

    The header is a row like any other; rows shorter than the first leave their last columns empty.
    """
    widths = [max(len(row[k]) for row in rows if k < len(row)) for k in range(len(rows[0]))] if rows else []
    return [
        (indent + "  ".join(f"{c:{'<' if k in text else '>'}{widths[k]}}" for k, c in enumerate(row))).rstrip()
        for row in rows
    ]


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]], text: Collection[int] = (0,)) -> None:
    """Print a header and its rows; see `columns`."""
    print(*columns([header, *rows], text), sep="\n")


def metres(value_m: float, sign: str = "") -> str:
    """Format a length with its unit: mm below 10 cm."""
    value_m = value_m if abs(value_m) > 5e-7 else 0.0  # no "-0 mm"
    return f"{1000.0 * value_m:{sign}.3g} mm" if abs(value_m) < 0.0995 else f"{value_m:{sign}.3g} m"
