"""The header of a CSV file with joint data."""

from __future__ import annotations

from collections.abc import Sequence


def explain_missing_time(
    header: Sequence[str], joint_names: Sequence[str], fields: Sequence[str]
) -> str:
    """
    Explain a header without the column `time`: which columns are expected, which were found.

    Parameters
    ----------
    header : sequence of str
        Cells of the first row.
    joint_names : sequence of str
        Joints of the robot.
    fields : sequence of str
        The quantities that a joint may have, positions first.

    Returns
    -------
    text : str
        One line.

    """
    problem, found = "no column 'time'", list(header)
    separator = next((mark for mark in ';\t' if len(header) == 1 and mark in header[0]), None)
    if separator:
        name = 'tabs' if separator == '\t' else f"'{separator}'"
        problem = f"cells are separated by {name}, expected ','"
        found = [cell.strip() for cell in header[0].split(separator)]
    position, *others = fields
    columns = [f"'<joint>' or '<joint>.{position}'", *(f"'<joint>.{field}'" for field in others)]
    return (
        f"{problem}; the columns are {', '.join(found) or 'none'}; expected 'time' [s] and, per "
        f'joint, {", ".join(columns)}; the joints are {", ".join(joint_names)}'
    )
