"""What several commands take on the command line, read and checked."""

from __future__ import annotations

import argparse


def payload(text: str) -> list[float]:
    """Read a mass [kg], and maybe its centre of mass [m], parted by commas."""
    try:
        values = [float(word) for word in text.split(',')]
    except ValueError:
        values = []
    if len(values) not in (1, 4):
        raise argparse.ArgumentTypeError(f"'{text}' is not MASS or MASS,X,Y,Z")
    return values
