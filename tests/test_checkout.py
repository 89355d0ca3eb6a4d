"""The guard of the checkout lists what a test leaves there, and no other program."""

from tests.checkout import changed, listing


def test_what_is_made_removed_or_written_is_listed_but_caches_and_the_store_are_not(
    tmp_path,
):
    (tmp_path / "docs").mkdir()
    for name in ("kept", "written", "removed", "docs/page"):
        (tmp_path / name).write_text("text")
    before = listing(tmp_path)
    (tmp_path / "written").write_text("another text")
    (tmp_path / "removed").unlink()
    (tmp_path / "docs" / "made").touch()
    (tmp_path / "docs" / "__pycache__").mkdir()
    (tmp_path / "docs" / "__pycache__" / "page.pyc").touch()
    (tmp_path / "store" / "samples").mkdir(parents=True)
    (tmp_path / "store" / "samples" / "run.parquet").touch()
    assert changed(before, listing(tmp_path)) == ["docs/made", "removed", "written"]
