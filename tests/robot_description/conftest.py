import pytest

from .small_arm import GOOD


@pytest.fixture
def urdf(tmp_path):
    """Writes a URDF: the good arm of three joints, with these parts in the place of its own."""

    def write(text=None, **parts):
        path = tmp_path / "arm.urdf"
        path.write_text(text or f'<robot name="small">{"".join((GOOD | parts).values())}</robot>')
        return path

    (tmp_path / "junk.stl").write_text("junk")
    return write


@pytest.fixture
def write(tmp_path):
    """Writes a URDF to a package in a folder of its own."""

    def write(text, name="package/arm.urdf"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return write
