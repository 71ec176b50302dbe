"""Fixtures for the tests of the commands: a working directory, and the size of a picture."""

import pytest


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Run in a temporary directory; skip without the dependencies of the extra `cli`."""
    for package in ('matplotlib', 'rosbags', 'yaml'):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def size_of():
    """Return width and height of a PNG."""

    def size_of(path):
        data = path.read_bytes()
        assert data[:8] == b'\x89PNG\r\n\x1a\n'
        return int.from_bytes(data[16:20], 'big'), int.from_bytes(data[20:24], 'big')

    return size_of
