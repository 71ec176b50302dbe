"""What the tests of the commands share: a place to write to, and what a picture is."""

import pytest


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Commands write where they are started; they need what the extra `cli` brings."""
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
