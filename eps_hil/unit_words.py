"""A unit as people read it behind a number: a share or a factor has none."""


def spaced(unit: str) -> str:
    """`` Nm`` to stand behind a number; nothing where the number has no dimension ("1")."""
    return f" {of(unit)}".rstrip()


def of(unit: str) -> str:
    """``Nm`` for a column of units; nothing where there is no dimension."""
    return "" if unit == "1" else unit
