"""
Writes the output files of a command without destroying other files.

An input is never replaced. Any other existing file is replaced only with --force, or if the file
is an unchanged output of an earlier call. Each output is marked with the hash of its content, in
an extended attribute. On file systems without extended attributes, replacing a file always needs
--force.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
import hashlib
import os
from pathlib import Path
import secrets
import shutil
import sys

from ..analysis.recordings.files import BAG_SUFFIXES
from ..errors import InverseDynamicsError

PICTURE_SUFFIXES = ('.png', '.svg', '.pdf')
_MARK = 'user.inverse_dynamics.sha256'
_STREAMS = ('/dev/std', '/dev/fd/', '/proc/')


class OutputError(InverseDynamicsError):
    """An output cannot be written, or would replace a file that must be kept."""


def output_path(text: str) -> Path:
    """Parse the path of an output; raise ArgumentTypeError if the output cannot be written."""
    path = Path(text)
    folder = path.parent
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"'{text}' is a folder, expected the name of a file")
    if not folder.is_dir():
        raise argparse.ArgumentTypeError(f"folder '{folder}' does not exist")
    needed = [path] if path.exists() else []
    needed += [] if _is_stream(path) else [Path(os.path.realpath(path)).parent]
    if not all(os.access(each, os.W_OK) for each in needed):
        raise argparse.ArgumentTypeError(f"no permission to write '{text}'")
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

    The keys of `outputs`, such as '--picture', name the outputs in error messages.
    The input ``-`` is standard input.
    Raise OutputError if an output is also an input or another output, even through a link.
    Without `force`, raise OutputError if an output exists, unless the file is an unchanged output
    of an earlier call.
    """
    sources = {_identity(file): file for source in inputs for file in _files_of(source)}
    written: dict[object, str] = {}
    for option, path in outputs.items():
        if path is None or _is_stream(path):
            continue
        where, identity = f'{option} {path}', _identity(path)
        if identity in sources:
            raise OutputError(
                f'{where} is the input {sources[identity]}, which is never replaced; choose '
                'another name'
            )
        if identity in written:
            raise OutputError(f'{where} is also the output of {written[identity]}')
        written[identity] = option
        if path.exists() and not force and not _is_unchanged_output(path):
            raise OutputError(
                f'{where} already exists; choose another name, or replace the file with --force'
            )


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
        temporary.touch(exist_ok=False)
        if target.exists():
            shutil.copymode(target, temporary)
        yield temporary
        _complete(temporary)
        temporary.replace(target)
    except OSError as error:  # the error may name the temporary file
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_file(path: Path, content: bytes) -> None:
    """Write an output as described for `new_file`."""
    with new_file(path) as temporary:
        temporary.write_bytes(content)


def _complete(path: Path) -> None:
    """Mark the file as an output, and flush the file to the disk."""
    with suppress(OSError):  # not all file systems have extended attributes
        os.setxattr(path, _MARK, _digest(path))
    with path.open('rb') as file:
        os.fsync(file.fileno())


def _is_unchanged_output(path: Path) -> bool:
    try:
        return os.getxattr(path, _MARK) == _digest(path)
    except OSError:  # no mark
        return False


def _digest(path: Path) -> bytes:
    return hashlib.sha256(path.read_bytes()).hexdigest().encode()


def _identity(path: Path) -> object:
    """Return a value that is equal for all links to the same file."""
    try:
        status = os.fstat(sys.stdin.fileno()) if str(path) == '-' else path.stat()
    except (OSError, ValueError):  # no such file, or a closed standard input
        return os.path.realpath(path)
    return status.st_dev, status.st_ino


def _files_of(source: Path) -> list[Path]:
    """List the files of an input, which can be the folder of a recording."""
    if not source.is_dir():
        return [source]
    return [
        file
        for file in source.iterdir()
        if file.name == 'metadata.yaml' or set(file.suffixes) & set(BAG_SUFFIXES)
    ]


def _is_stream(path: Path) -> bool:
    """Return whether a path is a stream, such as a pipe or /dev/null."""
    return str(path).startswith(_STREAMS) or (path.exists() and not path.is_file())
