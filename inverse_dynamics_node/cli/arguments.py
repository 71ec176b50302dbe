"""Arguments that several commands share."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

PICTURES = ('.png', '.svg', '.pdf')
"""What pictures may be."""


def output_path(text: str) -> Path:
    """
    Read the name of a file to write.

    Raises
    ------
    argparse.ArgumentTypeError
        If it cannot be written there.

    """
    path = Path(text)
    folder = path.parent
    if path.is_dir():
        raise argparse.ArgumentTypeError(f'{text}: is a folder, expected the name of a file')
    if not folder.is_dir():
        raise argparse.ArgumentTypeError(f"{text}: there is no folder '{folder}'")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise argparse.ArgumentTypeError(f'{text}: no permission to write')
    return path


def picture_path(text: str) -> Path:
    """
    Read the name of a picture to write; its suffix says of which kind.

    Raises
    ------
    argparse.ArgumentTypeError
        If it cannot be written there, or is of no kind that can be drawn.

    """
    path = output_path(text)
    if path.suffix.lower() not in PICTURES:
        raise argparse.ArgumentTypeError(
            f"{text}: is of kind '{path.suffix}', expected .png, .svg or .pdf"
        )
    return path


def payload(text: str) -> list[float]:
    """Read a mass [kg], and maybe its centre of mass [m], parted by commas."""
    try:
        values = [float(word) for word in text.split(',')]
    except ValueError:
        values = []
    if len(values) not in (1, 4):
        raise argparse.ArgumentTypeError(f"'{text}' is not MASS or MASS,X,Y,Z")
    return values
