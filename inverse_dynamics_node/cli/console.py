"""
Prints results, shows progress, handles signals, and writes output files.

An input is never replaced by an output. Any other existing file is replaced only with --force.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
import json
import math
import os
from pathlib import Path
import secrets
import signal
import sys
from typing import Any

from ..analysis.recordings.files import BAG_SUFFIXES
from ..errors import escaped, InverseDynamicsError, plain
from ..report.tables import wrapped

PICTURE_SUFFIXES = ('.png', '.svg', '.pdf')


def show(*texts: str) -> None:
    """Print each text, followed by an empty line."""
    for text in texts:
        print(f'{text}\n')


def say(text: str) -> None:
    """Print one paragraph."""
    print('\n'.join(wrapped(text)))


def print_json(result: Any) -> None:
    """Print a result as JSON; numbers that are not finite become null."""
    print(json.dumps(_finite(result), indent=2))


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(each) for name, each in value.items()}
    value = plain(value)
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextmanager
def progress(label: str) -> Iterator[Callable[[float], None]]:
    """Show the label on a terminal; yield a function that shows the completed fraction."""
    if not sys.stderr.isatty():
        yield lambda fraction: None
        return

    def report(fraction: float) -> None:
        print(f'\r{escaped(label)} {fraction:.0%} ', end='', file=sys.stderr, flush=True)

    print(escaped(label), end='', file=sys.stderr, flush=True)
    try:
        yield report
    finally:
        print('\r\x1b[K', end='', file=sys.stderr, flush=True)  # clears the line


@contextmanager
def handled_signals(handle: Callable[[int, object], object]) -> Iterator[None]:
    """Call `handle` for SIGINT, SIGTERM and SIGHUP in the ``with`` block."""
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def collected_signals() -> Iterator[list[int]]:
    """Collect SIGINT, SIGTERM and SIGHUP in a list, so that the ``with`` block can end cleanly."""
    received: list[int] = []
    with handled_signals(lambda number, _: received.append(number)):
        yield received


class OutputError(InverseDynamicsError):
    """An output would replace a file that must be kept."""


def output_path(text: str) -> Path:
    """Parse the path of an output; raise ArgumentTypeError if it cannot be the path of a file."""
    path = Path(text)
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"'{text}' is a folder, expected the name of a file")
    if not path.parent.is_dir():
        raise argparse.ArgumentTypeError(f"folder '{path.parent}' does not exist")
    return path


def picture_path(text: str) -> Path:
    """Parse the path of a picture; raise ArgumentTypeError for a path without a picture suffix."""
    path = output_path(text)
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise argparse.ArgumentTypeError(
            f"'{text}' has the suffix '{path.suffix}', expected .png, .svg or .pdf"
        )
    return path


def check_outputs(
    inputs: Iterable[Path], outputs: Mapping[str, Path | None], force: bool = False
) -> None:
    """
    Check that the outputs of a command do not replace a file that must be kept.

    The keys of `outputs`, such as '--picture', name the outputs in error messages. The input ``-``
    is standard input. Raise OutputError if an output is also an input or another output, even
    through a symbolic link. Raise OutputError if an output exists, unless `force` is true.
    """
    sources = {os.path.realpath(file) for path in inputs for file in _files_of(path)}
    written: dict[str, str] = {}
    for option, path in outputs.items():
        if path is None or _is_stream(path):
            continue
        target, where = os.path.realpath(path), f'{option} {path}'
        if target in sources:
            raise OutputError(f'{where} is an input, which is never replaced; choose another name')
        if target in written:
            raise OutputError(f'{where} is also the output of {written[target]}')
        if path.exists() and not force:
            raise OutputError(
                f'{where} already exists; choose another name, or replace the file with --force'
            )
        written[target] = option


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """
    Yield the path of a temporary file, which replaces the output if the `with` body succeeds.

    If the body fails, an existing output is not changed. If the path is a symbolic link, the
    target of the link is replaced. If the output cannot be written, raise an OSError that names
    `path`, not the temporary file.
    """
    if _is_stream(path):
        yield path
        return
    target = Path(os.path.realpath(path))
    # The suffix selects the format of a picture.
    temporary = target.with_name(f'.{secrets.token_hex(8)}{target.suffix}')
    try:
        yield temporary
        temporary.replace(target)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_file(path: Path, content: bytes) -> None:
    """Write an output as described for `new_file`."""
    with new_file(path) as temporary:
        temporary.write_bytes(content)


def _files_of(source: Path) -> list[Path]:
    """List an input and, if it is the folder of a recording, its files."""
    if str(source) == '-':
        return [Path('/dev/stdin')]
    names = 'metadata.yaml', *(f'*{suffix}*' for suffix in BAG_SUFFIXES)
    return [source, *(file for name in names for file in source.glob(name))]


def _is_stream(path: Path) -> bool:
    """Return whether a path is a stream, such as a pipe or /dev/null."""
    return str(path).startswith(('/dev/', '/proc/')) or (path.exists() and not path.is_file())
